// Method `paper`, once before the passes: a texel's observations as every pass reads them.
//
// u_facts holds blocks of rows as the atlas does, first one for each group, then 1 + LIGHTS for each layer:
//   group  cos_v, 1 where the texel is observed at all
//   layer  f of R, G and B (1/sr), weight: that of the other methods over the sum of weight * f^2
//   lobe   sin2h, spread, tan2 of the light's angle, factor
// Drawn once for each block u_block; u_first is where it starts, less the tile's first texel.
#define texel_here place_here  // the kernel's own place is in u_facts; that of the texel follows from it
#include "include/kernel.glsl"
#undef texel_here
uniform ivec2 u_first;
ivec2 texel_here() { return place_here() - u_first; }
#include "solve/observations.glsl"
uniform int u_block;

float power = 0.0;

void add_group(int k, int first, int end) {
    for (int n = first; n < end; n++) {
#if CHANNELS == 3
        obs_rgb[n] = vec3(obs_f[n] + group_base[k]);  // of the group's one channel
#endif
        power += obs_weight[n] * dot(obs_rgb[n], obs_rgb[n]) / 3.0;
    }
}

void kernel() {
    out_0 = vec4(0.0);
    if (!load_observations()) return;
#define GROUP(k, first, end) add_group(k, first, end);
    EACH_GROUP
    if (u_block < GROUPS) {
        out_0.xy = vec2(group_cos_v[u_block], 1.0);
        return;
    }
    int n = (u_block - GROUPS) / (1 + LIGHTS), part = (u_block - GROUPS) % (1 + LIGHTS);
    int i = n * LIGHTS + part - 1;
    if (part == 0) out_0 = vec4(obs_rgb[n], obs_weight[n] / max(power, 1e-20));
    else out_0 = vec4(lobe_sin2h[i], spread_of(i), lobe_tan2[i], lobe_factor[i]);
}
