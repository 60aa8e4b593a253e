// Method `paper`: a tile's bests into the whole maps.
#include "include/kernel.glsl"
uniform sampler2D u_best;
uniform sampler2D u_more;
uniform ivec2 u_tile;  // first texel

void kernel() {
    out_0 = texelFetch(u_best, texel_here() - u_tile, 0);
    out_1 = texelFetch(u_more, texel_here() - u_tile, 0);
}
