// Another object in front: the pixel shows nothing of the surface.
in float v_depth;
layout(location = 0) out vec4 o_position;
layout(location = 1) out vec4 o_normal;
layout(location = 2) out vec4 o_facet;
layout(location = 3) out vec4 o_uv;
layout(location = 4) out vec4 o_uv_slope;

void main() {
    o_position = o_normal = o_facet = o_uv = o_uv_slope = vec4(0.0);
}
