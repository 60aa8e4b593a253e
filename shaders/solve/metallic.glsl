// Observations of a material that is in part a metal: f = b a + s with, per observation,
//     a = (1 - m) (1 - A) / pi + m g (white - black),   s = (1 - m) spec + m g black
// m: Metallic; b: base colour of the channel; black and white: what the lobe of a metal so coloured returns; g(b): its
// gain by multiple scattering (metal_gain_d in include/brdf.glsl).  TINTED: observations are means of R, G and B, which
// are known too (COLOUR): the mean of g over them is then no g of the mean, and what black and white return gain apart.
//
// a differs from one observation of a group to the next, so each is divided by it: (f - s) / a is the base colour that
// it shows, and weighs w a^2.  g is that of the base colour which all together say, a fixed point found by Newton's
// steps from that of the last evaluation; its derivative by roughness is part of the slopes.

// Steps to the fixed point, each from where the last ended: digits are left from any start.  Where outliers are sought
// there are such steps before; llvmpipe ends a shader's loops after 65535 rounds in all.
#ifdef ROBUST
const int SETTLED = 1;
#else
const int SETTLED = 4;
#endif
const float LEAST_A = 1e-6;  // 1/sr: a metal reflects no light there

#ifdef ROBUST
#define TRUSTED(n) (obs_weight[n] * obs_trust[n])
#else
#define TRUSTED(n) obs_weight[n]
#endif

float metal_weight[LAYERS];                           // w a^2
float metal_other[LAYERS], metal_d_other[LAYERS];     // (1 - m) spec, and its derivative by roughness
vec2 metal_lobe[LAYERS], metal_d_lobe[LAYERS];        // m (black, white - black)
vec3 group_own[GROUPS];  // base colour that the group alone says, its derivatives by roughness and by that of all
CHANNEL texel_base = CHANNEL(0.5), texel_base_slope;  // of the fixed point, and its derivative by roughness
#ifdef TINTED
vec3 texel_tint = vec3(1.0);  // R, G and B of the base colour over their mean
#endif

void prepare_metal(int k, int first, int end, float r) {
    Toward t = toward(r, group_cos_v[k]);
    group_toward[k] = t;
    EACH_OF_GROUP(n) {
        vec3 parts, slopes;
        metal_parts_d(n, r, t, parts, slopes);
        metal_other[n] = parts.x;
        metal_d_other[n] = slopes.x;
        metal_lobe[n] = parts.yz;
        metal_d_lobe[n] = slopes.yz;
    }
}

// Of the black part and of what white adds: the same, but where an observation is the mean of three channels.
struct Gain { vec2 value, d_roughness, d_base; };

Gain gain_of(int k) {
    float base = sum(texel_base * channel_of(k));
#ifdef TINTED
    Gain g = Gain(vec2(0.0), vec2(0.0), vec2(0.0));
    for (int c = 0; c < 3; c++) {
        float value, d_roughness, d_base;
        vec2 share = vec2(1.0, texel_tint[c]) / 3.0;
        metal_gain_d(min(base * texel_tint[c], 1.0), group_toward[k].metal, group_toward[k].d_metal, value, d_roughness,
                     d_base);
        g.value += share * value;
        g.d_roughness += share * d_roughness;
        g.d_base += share * texel_tint[c] * d_base;
    }
    return g;
#else
    float value, d_roughness, d_base;
    metal_gain_d(base, group_toward[k].metal, group_toward[k].d_metal, value, d_roughness, d_base);
    return Gain(vec2(value), vec2(d_roughness), vec2(d_base));
#endif
}

// (a, its derivative by roughness; f - s, the same of s) of an observation, f in 1/sr.
vec4 parts_of(int n, int k, vec2 gain, vec2 d_gain) {
    vec2 lobe = gain * metal_lobe[n], d_lobe = gain * metal_d_lobe[n] + d_gain * metal_lobe[n];
    float rest = 1.0 - u_metallic;
    return vec4(max(rest * group_toward[k].diffuse + lobe.y, LEAST_A), rest * group_toward[k].d_diffuse + d_lobe.y,
                obs_f[n] + group_base[k] - metal_other[n] - lobe.x, metal_d_other[n] + d_lobe.x);
}

struct Settling { CHANNEL weight, base, by_base, by_roughness; vec3 tint; };  // sums; derivatives at fixed weights

void settle_group(int k, int first, int end, inout Settling all) {
    Gain g = gain_of(k);
    float information = 1e-20, off = 0.0;
    vec3 tint = vec3(0.0), by_gain = vec3(0.0), by_roughness = vec3(0.0);  // derivatives of sums that own is made of
    EACH_OF_GROUP(n) {
        vec4 p = parts_of(n, k, g.value, g.d_roughness);
        float w = TRUSTED(n);
        information += w * p.x * p.x;
        off += w * p.x * p.z;
        vec2 by_base = g.d_base * metal_lobe[n];
        by_gain += w * vec3(by_base.y * p.z, p.x * by_base.yx);
#ifdef TINTED
        tint += w * p.x * (obs_rgb[n] - obs_f[n] - group_base[k]);
#endif
        by_roughness += w * vec3(p.y * p.z, p.x * p.yw);
    }
    float own = off / information;
    vec3 of_own = vec3(1.0, -2.0 * own, -1.0) / information;
    float w = information / (1.0 + u_group_slack * information * own * own);
    all.weight += w * channel_of(k);
    all.base += w * own * channel_of(k);
    vec2 slope = vec2(dot(by_gain, of_own), dot(by_roughness, of_own));
    all.by_base += w * slope.x * channel_of(k);
    all.by_roughness += w * slope.y * channel_of(k);
    all.tint += w / information * tint;
    group_own[k] = vec3(own, slope.yx);
}

// Each observation in the form that it has where a is the same for all: about its group's base colour, and that one's
// derivative.
void share_out(int k, int first, int end) {
    Gain g = gain_of(k);
    float base_slope = sum(texel_base_slope * channel_of(k));
    vec2 d_gain = g.d_roughness + g.d_base * base_slope;
    vec3 own = group_own[k];
    own.y += own.z * base_slope;
    group_own[k] = own;
    EACH_OF_GROUP(n) {
        vec4 p = parts_of(n, k, g.value, d_gain);
        metal_weight[n] = obs_weight[n] * p.x * p.x;
        obs_off[n] = p.z / p.x - own.x;
        obs_slope[n] = (p.w + own.x * p.y) / p.x + own.y;
    }
}

// To the fixed point under the present trust, where observations are shared out.
void settle() {
    for (int i = 0; i < SETTLED; i++) {
        Settling all = Settling(CHANNEL(1e-20), CHANNEL(0.0), CHANNEL(0.0), CHANNEL(0.0), vec3(0.0));
#define GROUP(k, first, end) settle_group(k, first, end, all);
        EACH_GROUP
#undef GROUP
        CHANNEL said = all.base / all.weight, inside = step(CHANNEL(0.0), said) * step(said, CHANNEL(1.0));
        CHANNEL steep = 1.0 - inside * all.by_base / all.weight;
        texel_base = clamp(texel_base + (clamp(said, 0.0, 1.0) - texel_base) / steep, 0.0, 1.0);
#ifdef TINTED
        vec3 said_of = max(said + all.tint / all.weight, 0.0);
        texel_tint = 3.0 * said_of / max(dot(said_of, vec3(1.0)), 1e-6);
#endif
        texel_base_slope = inside * all.by_roughness / (all.weight * steep);
    }
#define GROUP(k, first, end) share_out(k, first, end);
    EACH_GROUP
#undef GROUP
}

// One group's observations, as the last settle() has left them.
void add_group(int k, int first, int end, float r, inout vec3 fit, inout Total total) {
    vec3 squares = vec3(0.0), sums = vec3(0.0);
#ifdef TILTS
    vec2 b = vec2(0.0), bd = vec2(0.0), bs = vec2(0.0);  // as of Group in solve/fit.glsl
#endif
    EACH_OF_GROUP(n) {
#ifdef ROBUST
        float w = metal_weight[n] * obs_trust[n];
#else
        float w = metal_weight[n];
#endif
        float d = obs_off[n], ds = obs_slope[n];
        sums += w * vec3(1.0, d, ds);
        squares += w * vec3(d * d, ds * d, ds * ds);
#ifdef TILTS
        // The slopes are those of observations, which are base colours times a here.
        vec2 tilt = obs_tilt[n] * sqrt(metal_weight[n] / max(obs_weight[n], 1e-30));
#ifdef ROBUST
        tilt *= obs_trust[n];
#endif
        b += tilt;
        bd += tilt * d;
        bs += tilt * ds;
#endif
    }
    if (sums.x <= 0.0) return;
    vec2 mean = sums.yz / sums.x;
#ifdef TILTS
    bd -= mean.x * b;
    // The slope has how a base colour truly changes: what a tilt explains is not orthogonal to it.
    vec2 d_tilt = bs - mean.y * b;
    squares -= vec3(dot(bd, bd), dot(bd, bs), dot(d_tilt, d_tilt));
    fit_tilts += dot(bd, bd);
#endif
    squares -= vec3(mean.x * sums.y, mean.x * sums.z, mean.y * sums.z);
    fit += vec3(max(squares.x, 0.0), squares.y, max(squares.z, 0.0));
    float own = group_own[k].x + mean.x;
    join(own, group_own[k].y, sums.x / (1.0 + u_group_slack * sums.x * own * own), channel_of(k), total);
}
