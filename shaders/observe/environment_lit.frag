// How much of each of a batch's 64 directions lights a pixel: a byte each, in the order of the outputs, their components and
// the bytes of these.
//
// Defines: EMITTERS for patches of meshes.
#include "include/pixel.glsl"
#include "include/shadow.glsl"
#include "observe/environment.glsl"
uniform sampler2D u_facet;
uniform sampler2D u_shadow;   // linear depth from u_center on, nearest: the batch's maps

layout(location = 0) out uvec4 o_lit[4];

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
    ivec2 here = ivec2(gl_FragCoord.xy);
    Pixel pixel;
    if (!load_pixel(here, pixel)) discard;
    P = pixel.P;
    N = pixel.N;
    dx = pixel.dNdx;
    dy = pixel.dNdy;
    vec4 facet = texelFetch(u_facet, here, 0);
    // Those above first, then their shadows: a software renderer executes what a branch leaves out, but ends a loop.
    Batch waiting = none();
    for (int n = 0; n < u_count; n++) {
        uint bit = uint(above(u_first + n)) << uint(n & 31);
        if (n < 32) waiting.low |= bit;
        else waiting.high |= bit;
    }
    uvec4 lit_0 = uvec4(0u), lit_1 = lit_0, lit_2 = lit_0, lit_3 = lit_0;
    while (some(waiting)) {
        int n = taken_from(waiting);
        uint lit = uint(lit_of(n, direction(u_first + n), facet) * 255.0 + 0.5) << uint(8 * (n & 3));
        uvec4 placed = lit * uvec4(equal(ivec4(n >> 2 & 3), ivec4(0, 1, 2, 3)));
        int of = n >> 4;
        lit_0 |= placed * uint(of == 0);
        lit_1 |= placed * uint(of == 1);
        lit_2 |= placed * uint(of == 2);
        lit_3 |= placed * uint(of == 3);
    }
    o_lit[0] = lit_0;
    o_lit[1] = lit_1;
    o_lit[2] = lit_2;
    o_lit[3] = lit_3;
}
