// How many triangles cover a texel (additive blending): more than one is an overlap of UVs.  Without blending: whether
// one does.
layout(location = 0) out float o_count;

void main() {
    o_count = 1.0;
}
