// Positions alone: other objects that hide the surface, and every caster seen from a light.
in vec3 in_position;
uniform mat4 u_clip;
uniform vec4 u_depth_plane;  // linear depth = dot(plane, (P, 1))
out float v_depth;

void main() {
    v_depth = dot(u_depth_plane, vec4(in_position, 1.0));
    gl_Position = u_clip * vec4(in_position, 1.0);
}
