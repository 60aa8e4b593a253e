// Method `paper`, once before the passes: a texel's observations as every pass reads them.
//
// u_facts holds 2 + LIGHTS blocks for each observation that a texel keeps, in the atlas' order:
//   0      f of R, G, B (1/sr), weight: that of the other methods over the sum of weight * f^2; negative: first of
//          its group (camera, and channel where each has its own observations)
//   1      cos_v, how much each of R, G and B counts; read for the first of a group only
//   2 + l  lobe of light l: sin2h, spread, tan2 of the light's angle, factor
// A weight of 0 ends the list.  Drawn once for each block u_block; its rows start at u_first.
#define texel_here place_here  // the kernel's own place is in u_facts; that of the texel follows from it
#include "include/kernel.glsl"
#undef texel_here
uniform ivec2 u_first;  // of the block, less the tile's first texel
ivec2 texel_here() { return place_here() - u_first; }
#include "solve/observations.glsl"
uniform int u_block;
uniform bool u_single_channel;  // every observation is of one channel

vec3 counts(int n) {
    return u_single_channel ? vec3(equal(ivec3(obs_channel[n]), ivec3(0, 1, 2))) : vec3(1.0 / 3.0);
}

void kernel() {
    out_0 = vec4(0.0);
    int n = u_block / (2 + LIGHTS), part = u_block % (2 + LIGHTS);
    if (!load_observations() || n >= obs_count) return;
    float power = 0.0;
    for (int i = 0; i < obs_count; i++) {
        power += abs(obs_weight[i]) * dot(counts(i), obs_rgb[i] * obs_rgb[i]);
    }
    if (part == 0) out_0 = vec4(obs_rgb[n], obs_weight[n] / max(power, 1e-20));
    else if (part == 1) out_0 = vec4(obs_cos_v[n], counts(n));
    else {
        int i = n * LIGHTS + part - 2;
        out_0 = vec4(lobe_sin2h[i], lobe_spread[i], lobe_tan2[i], lobe_factor[i]);
    }
}
