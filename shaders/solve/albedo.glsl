// Base colour of each texel from its own observations, at the roughness found: weighted least squares per channel.
// (The product's maps come from gpu/maps/albedo.py, which also knows how far pixels reach; this is what a texel alone says.)
#include "solve/observations.glsl"
#ifdef ROBUST
#include "solve/fit.glsl"
#endif
uniform sampler2D u_found;  // roughness; with two lobes roughness1, roughness2, weight

void add_group(int k, int first, int end, vec4 found, inout vec3 sum, inout vec3 total) {
#if LOBES == 2
    Toward one = toward(found.x, group_cos_v[k]), two = toward(found.y, group_cos_v[k]);
    float a = mix(two.diffuse, one.diffuse, found.z);
#else
    Toward one = toward(found.x, group_cos_v[k]);
    float a = one.diffuse;
#endif
    for (int n = first; n < end; n++) {
        float s, ds, w = obs_weight[n];
        specular_d(n, found.x, one, s, ds);
#ifdef ROBUST
        w *= obs_trust[n];
#endif
#if LOBES == 2
        float s2;
        specular_d(n, found.y, two, s2, ds);
        s = mix(s2, s, found.z);
#endif
#if CHANNELS == 3
        int c = GROUP_CHANNEL[k];
        vec3 share = w * vec3(c == 0, c == 1, c == 2), f = vec3(obs_f[n] + group_base[k]);
#else
        vec3 share = vec3(w), f = obs_rgb[n];
#endif
        sum += share * a * (f - s);
        total += share * a * a;
    }
}

void kernel() {
    out_0 = vec4(0.0);
    if (!load_observations()) return;
    vec4 found = texelFetch(u_found, texel_here(), 0);
    vec3 sum = vec3(0.0), total = vec3(0.0);
#ifdef ROBUST
    obs_variance = noise_around(u_noise, texel_here(), textureSize(u_texel_position, 0));
    disbelieve(found.x);
#endif
#define GROUP(k, first, end) add_group(k, first, end, found, sum, total);
    EACH_GROUP
    out_0 = vec4(clamp(sum / max(total, vec3(1e-20)), 0.0, 1.0), 1.0);
}
