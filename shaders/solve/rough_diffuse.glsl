// What a rough diffuse makes of a texel's observations: they are divided by what it shows over what a smooth one does.
#if CHANNELS == 3
#define SHOWN_OF(n) vec3(obs_f[n])
#else
#define SHOWN_OF(n) obs_rgb[n]
#endif

// Reads what a rough diffuse does to each observation; returns rough_bounce of the base colour that they typically
// show.  What it reads stays in obs_f, obs_rgb and obs_weight until the observations are loaded.
vec3 rough_bounces(ivec2 at) {
    vec3 typical = vec3(1e30);
    vec2 mean = vec2(0.0);
    float good = 1e-12;
    for (int n = 0; n < LAYERS; n++) {
        vec4 o = texelFetch(u_observations, at + ivec2(0, n * BLOCKS * u_tile_height), 0);
        obs_f[n] = o.x;
#if CHANNELS == 1
        obs_rgb[n] = texelFetch(u_observations, at + ivec2(0, (n * BLOCKS + 1) * u_tile_height), 0).rgb;
#endif
        obs_weight[n] = int(o.w) % 2 == 1 ? 0.0 : max(o.y, 0.0);
        obs_rough[n] = vec2(1.0, 0.0);
        for (int l = 0; l < LIGHTS; l++) {
            vec4 v = texelFetch(u_observations, at + ivec2(0, (n * BLOCKS + 2 + l) * u_tile_height), 0);
            if (o.y > 0.0) obs_rough[n] += rough_share(v, max(o.z, 1e-3), u_diffuse_roughness);
        }
        mean += step(1e-12, obs_weight[n]) * obs_rough[n];
        good += step(1e-12, obs_weight[n]);
    }
    for (int pass = 0; pass < 4; pass++) {
        vec3 sum = vec3(0.0), total = vec3(1e-12);
        for (int g = 0; g < GROUPS; g++) {
#if CHANNELS == 3
            int c = GROUP_CHANNEL[g];
            vec3 own = vec3(c == 0, c == 1, c == 2);
#else
            const vec3 own = vec3(1.0);
#endif
            for (int n = GROUP_START[g]; n < GROUP_START[g + 1]; n++) {
                vec3 f = max(SHOWN_OF(n), 0.0), w = own * obs_weight[n] / (pass == 0 ? vec3(1.0) : max(f, typical));
                sum += w * f;
                total += w;
            }
        }
        typical = max(sum / total, 1e-4);
    }
    mean = good > 0.5 ? mean / good : vec2(1.0, 0.0);
    vec3 base = clamp(PI * typical, 0.0, 1.0);
    for (int i = 0; i < 3; i++) {
        base = clamp(PI * typical / (mean.x + mean.y * rough_bounce(base, u_diffuse_roughness)), 0.0, 1.0);
    }
    vec3 bounce = rough_bounce(base, u_diffuse_roughness);
    // An observation that is the mean of R, G and B has theirs by what each of them shows.
    float all = dot(base, bounce) / max(dot(base, vec3(1.0)), 1e-6);
    for (int g = 0; g < GROUPS; g++) {
        for (int n = GROUP_START[g]; n < GROUP_START[g + 1]; n++) {
#if CHANNELS == 3
            all = bounce[GROUP_CHANNEL[g]];
#endif
            obs_gain[n] = obs_rough[n].x + obs_rough[n].y * all;
        }
    }
    return bounce;
}
