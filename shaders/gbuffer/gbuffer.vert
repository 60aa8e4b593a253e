// The mesh, drawn over the texel grid or through a camera (the pixel grid).
#include "include/projection.glsl"
in vec3 in_position;       // world
in vec3 in_normal;         // world, unit
in vec2 in_uv;
in vec2 in_grid;           // place on the texel grid: the UVs, unless the grid is another part of their plane
in vec4 in_facet;          // world facet normal, lift of the smooth surface over the facet (metres)
#ifdef NORMAL_MAP
in vec3 in_object_normal;  // object space, unit
in vec4 in_tangent;        // object space, w = sign of the bitangent
#endif

uniform bool u_in_uv;

out vec3 v_position;
out vec3 v_normal;
out vec2 v_uv;
out vec2 v_grid;
flat out vec4 v_facet;
#ifdef NORMAL_MAP
out vec3 v_object_normal;
out vec4 v_tangent;
#endif

void main() {
    v_position = in_position;
    v_normal = in_normal;
    v_uv = in_uv;
    v_grid = in_grid;
    v_facet = in_facet;
#ifdef NORMAL_MAP
    v_object_normal = in_object_normal;
    v_tangent = in_tangent;
#endif
    gl_Position = u_in_uv ? vec4(in_grid * 2.0 - 1.0, 0.0, 1.0) : clip_of(in_position);
}
