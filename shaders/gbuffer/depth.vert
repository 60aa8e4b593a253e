// Positions alone: other objects that hide the surface, and every caster seen from a light.
#include "include/projection.glsl"
in vec3 in_position;
uniform vec4 u_depth_plane;  // linear depth = dot(plane, (P, 1))
out float v_depth;

void main() {
    v_depth = dot(u_depth_plane, vec4(in_position, 1.0));
    gl_Position = clip_of(in_position);
}
