// Texels that belong to the region: of those that several triangles claim, where one of them does.
in float v_weight;

layout(location = 0) out float o_inside;

void main() {
    if (v_weight <= 0.5) discard;
    o_inside = 1.0;
}
