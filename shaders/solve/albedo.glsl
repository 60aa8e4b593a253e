// Base colour of each texel from its own observations, at the roughness found: weighted least squares per channel.
// (The product's maps come from gpu/albedo.py, which also knows how far pixels reach; this is what a texel alone says.)
#include "solve/observations.glsl"
uniform sampler2D u_found;  // roughness; with two lobes roughness1, roughness2, weight
uniform int u_channels;      // 1: an observation holds all three, 3: each is of one

void kernel() {
    out_0 = vec4(0.0);
    if (!load_observations()) return;
    vec4 found = texelFetch(u_found, texel_here(), 0);
    vec3 sum = vec3(0.0), total = vec3(0.0);
    for (int n = 0; n < obs_count; n++) {
#if LOBES == 2
        float a = mix(observed_diffuse(n, found.y), observed_diffuse(n, found.x), found.z);
        float s = mix(observed_specular(n, found.y), observed_specular(n, found.x), found.z);
#else
        float a = observed_diffuse(n, found.x), s = observed_specular(n, found.x);
#endif
        int c = obs_channel[n];
        float w = abs(obs_weight[n]);
        vec3 one = u_channels == 3 ? vec3(c == 0, c == 1, c == 2) : vec3(1.0);
        vec3 f = u_channels == 3 ? vec3(obs_f[n] + obs_base[n]) : obs_rgb[n];
        sum += one * w * a * (f - s);
        total += one * w * a * a;
    }
    out_0 = vec4(clamp(sum / max(total, vec3(1e-20)), 0.0, 1.0), 1.0);
}
