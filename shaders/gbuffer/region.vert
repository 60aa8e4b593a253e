// The mesh over its UV square, with how far each corner belongs to the region.
in vec3 in_corner;  // u, v, weight

out float v_weight;

void main() {
    v_weight = in_corner.z;
    gl_Position = vec4(in_corner.xy * 2.0 - 1.0, 0.0, 1.0);
}
