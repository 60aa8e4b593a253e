// Observations of a material that is in part a metal: f = b a + s with, per observation,
//     a = (1 - m) (1 - A) / pi + m g (white - black),   s = (1 - m) spec + m g black
// m: Metallic; b: base colour of the channel; black and white: what the lobe of a metal so coloured returns; g(b): its
// gain by multiple scattering (metal_gain_d in include/brdf.glsl).
//
// a differs from one observation of a group to the next, so each is divided by it: (f - s) / a is the base colour that
// it shows, and weighs w a^2.  g is that of the base colour which all together say, a fixed point found by Newton's
// steps from that of the last evaluation; its derivative by roughness is part of the slopes.
const int SETTLED = 3;  // steps to the fixed point: from a start 0.3 off, 1e-6 is left
const float LEAST_A = 1e-6;  // 1/sr: a metal reflects no light there

#ifdef ROBUST
#define TRUSTED(n) (obs_weight[n] * obs_trust[n])
#else
#define TRUSTED(n) obs_weight[n]
#endif

float metal_weight[LAYERS];                           // w a^2
float metal_other[LAYERS], metal_d_other[LAYERS];     // (1 - m) spec, and its derivative by roughness
vec2 metal_lobe[LAYERS], metal_d_lobe[LAYERS];        // m (black, white - black)
float group_own[GROUPS], group_own_slope[GROUPS];     // base colour that the group alone says, and its derivative
CHANNEL texel_base = CHANNEL(0.5), texel_base_slope;  // of the fixed point, and its derivative by roughness

void prepare_metal(int k, int first, int end, float r) {
    Toward t = toward(r, group_cos_v[k]);
    group_toward[k] = t;
    for (int n = first; n < end; n++) {
        specular_d(n, r, t, metal_other[n], metal_d_other[n]);
        metal_d(n, r, t, metal_lobe[n], metal_d_lobe[n]);
    }
}

struct Gain { float value, d_roughness, d_base; };

Gain gain_of(int k) {
    Gain g;
    float base = sum(texel_base * channel_of(k));
    metal_gain_d(base, group_toward[k].metal, group_toward[k].d_metal, g.value, g.d_roughness, g.d_base);
    return g;
}

// (a, its derivative by roughness; f - s, the same of s) of an observation, f in 1/sr.
vec4 parts_of(int n, int k, float gain, float d_gain) {
    vec2 lobe = gain * metal_lobe[n], d_lobe = gain * metal_d_lobe[n] + d_gain * metal_lobe[n];
    float rest = 1.0 - u_metallic;
    return vec4(max(rest * group_toward[k].diffuse + lobe.y, LEAST_A), rest * group_toward[k].d_diffuse + d_lobe.y,
                obs_f[n] + group_base[k] - metal_other[n] - lobe.x, metal_d_other[n] + d_lobe.x);
}

struct Settling { CHANNEL weight, base, bend, slope; };  // sums; bend: minus the derivative by the base colour assumed

void settle_group(int k, int first, int end, inout Settling all) {
    Gain g = gain_of(k);
    float information = 1e-20, off = 0.0;
    vec3 by_gain = vec3(0.0), by_roughness = vec3(0.0);  // derivatives of sums that own is made of
    for (int n = first; n < end; n++) {
        vec4 p = parts_of(n, k, g.value, g.d_roughness);
        float w = TRUSTED(n);
        information += w * p.x * p.x;
        off += w * p.x * p.z;
        by_gain += w * vec3(metal_lobe[n].y * p.z, p.x * metal_lobe[n].yx);
        by_roughness += w * vec3(p.y * p.z, p.x * p.yw);
    }
    float own = off / information;
    vec3 of_own = vec3(1.0, -2.0 * own, -1.0) / information;
    float w = information / (1.0 + u_group_slack * information * own * own);
    all.weight += w * channel_of(k);
    all.base += w * own * channel_of(k);
    all.bend -= w * g.d_base * dot(by_gain, of_own) * channel_of(k);
    all.slope += w * dot(by_roughness, of_own) * channel_of(k);
}

// Each observation in the form that it has where a is the same for all: about its group's base colour, and that one's
// derivative.
void share_out(int k, int first, int end) {
    Gain g = gain_of(k);
    float d_gain = g.d_roughness + g.d_base * sum(texel_base_slope * channel_of(k));
    float information = 1e-20, off = 0.0;
    for (int n = first; n < end; n++) {
        vec4 p = parts_of(n, k, g.value, d_gain);
        information += TRUSTED(n) * p.x * p.x;
        off += TRUSTED(n) * p.x * p.z;
    }
    float own = off / information, straight = 0.0, turned = 0.0;
    for (int n = first; n < end; n++) {
        vec4 p = parts_of(n, k, g.value, d_gain);
        metal_weight[n] = obs_weight[n] * p.x * p.x;
        obs_off[n] = p.z / p.x - own;
        obs_slope[n] = (p.w + own * p.y) / p.x;
        straight += TRUSTED(n) * p.x * (p.w + own * p.y);
        turned += TRUSTED(n) * (p.z - own * p.x) * p.y;  // weights change with a too
    }
    group_own[k] = own;
    group_own_slope[k] = (turned - straight) / information;
    for (int n = first; n < end; n++) obs_slope[n] -= straight / information;
}

// To the fixed point under the present trust.
void settle() {
    for (int i = 0; i < SETTLED; i++) {
        Settling all = Settling(CHANNEL(1e-20), CHANNEL(0.0), CHANNEL(0.0), CHANNEL(0.0));
#define GROUP(k, first, end) settle_group(k, first, end, all);
        EACH_GROUP
#undef GROUP
        CHANNEL said = all.base / all.weight, inside = step(CHANNEL(0.0), said) * step(said, CHANNEL(1.0));
        CHANNEL steep = 1.0 + inside * all.bend / all.weight;
        texel_base = clamp(texel_base + (clamp(said, 0.0, 1.0) - texel_base) / steep, 0.0, 1.0);
        texel_base_slope = inside * all.slope / (all.weight * steep);
    }
#define GROUP(k, first, end) share_out(k, first, end);
    EACH_GROUP
#undef GROUP
}

// One group's observations, as the last settle() has left them.
void add_group(int k, int first, int end, float r, inout vec3 fit, inout Total total) {
    float information = 0.0;
    for (int n = first; n < end; n++) {
#ifdef ROBUST
        float w = metal_weight[n] * obs_trust[n];
#else
        float w = metal_weight[n];
#endif
        information += w;
        fit += w * vec3(obs_off[n] * obs_off[n], obs_slope[n] * obs_off[n], obs_slope[n] * obs_slope[n]);
    }
    if (information <= 0.0) return;
    float own = group_own[k];
    join(own, group_own_slope[k], information / (1.0 + u_group_slack * information * own * own), channel_of(k), total);
}
