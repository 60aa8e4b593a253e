// How much of a batch's directions, 16 in a row, lights a pixel: a byte each, in the order of the components and their
// bytes.
//
// Defines: EMITTERS for patches of meshes.
#include "include/pixel.glsl"
#include "include/shadow.glsl"
#include "observe/environment.glsl"
uniform sampler2D u_facet;
uniform sampler2D u_shadow;   // linear depth from u_center on, nearest: the batch's maps
uniform int u_place;          // of the 16 among the batch's
uniform ivec2 u_corner;       // of their place in the target

layout(location = 0) out uvec4 o_lit;

ivec2 corner_of(int map) {
    return SHADOW_SIDE * ivec2(uint(map) % uint(SHADOW_COLUMNS), uint(map) / uint(SHADOW_COLUMNS));
}

vec3 right_of(vec3 forward) {
    return normalize(cross(forward, abs(forward.z) < 0.9 ? vec3(0.0, 0.0, 1.0) : vec3(0.0, 1.0, 0.0)));
}

#ifdef EMITTERS
#include "observe/lit_by_emitters.glsl"
#else
#include "observe/lit_by_world.glsl"
#endif

void main() {
    ivec2 here = ivec2(gl_FragCoord.xy) - u_corner;
    Pixel pixel;
    if (!load_pixel(here, pixel)) discard;
    P = pixel.P;
    N = pixel.N;
    dx = pixel.dNdx;
    dy = pixel.dNdy;
    vec4 facet = texelFetch(u_facet, here, 0);
    uvec4 bytes = uvec4(0u);
    for (int k = 0; k < 16; k++) {
        int n = 16 * u_place + k;
        if (n >= u_count || !above(u_first + n)) continue;
        float lit = lit_of(n, direction(u_first + n), facet);
        bytes[k >> 2] |= uint(lit * 255.0 + 0.5) << uint(8 * (k & 3));
    }
    o_lit = bytes;
}
