// Linear depth seen from a light; MIN blending keeps the nearest.
in float v_depth;
layout(location = 0) out float o_depth;

void main() {
    o_depth = v_depth;
}
