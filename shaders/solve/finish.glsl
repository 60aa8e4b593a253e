// The last word on a texel where the data are so clean that neighbours need not be asked: what the search found, and
// how sure that is.
#include "include/kernel.glsl"
#include "solve/nodes.glsl"
uniform sampler2D u_valleys;  // the three outputs of solve/search.glsl; whole maps
uniform sampler2D u_support;
uniform sampler2D u_extra;
// out_0, out_1: as of solve/polish.glsl

void kernel() {
    out_0 = out_1 = vec4(0.0);
    ivec2 texel = texel_here();
    vec4 valleys = texelFetch(u_valleys, texel, 0), support = texelFetch(u_support, texel, 0);
    vec4 extra = texelFetch(u_extra, texel, 0);
    if (support.w < 0.5) return;
    float around = noise_around(u_noise, texel, textureSize(u_valleys, 0));
    float trust = belief(support.y, extra.w), off = valleys.z - valleys.x;
    float curvature = 2.0 * trust * data_slope(valleys.y, support.z, around) * support.x;
    // Of the valley, and of where else the roughness may be.
    float elsewhere = exp(-trust * data_cost(valleys.w, valleys.y, support.z, around)) * off * off;
    float variance = 1.0 / max(curvature, 1e-6) + elsewhere;
    out_0 = vec4(valleys.x, sqrt(min(variance, 0.25)), 1.0, 1.0);
    out_1 = vec4(support.y, valleys.y, extra.x, sqrt(extra.y * extra.y * variance + extra.z * around));
}
