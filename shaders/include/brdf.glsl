// The reflectance models, as Cycles renders them.  Twin: irpso_addon/core/shading/brdf.py.
// Principled BSDF (IOR 1.5, multiscatter GGX) at any Specular IOR Level and Metallic, under a coat; Cook-Torrance with Beckmann.
//
// alpha = roughness^2, alpha2 = alpha^2; cos_l, cos_v: N.L and N.V; cos_vh: V.H, H the half vector.
// sin2h: 1 - (N.H)^2, from dot(cross(N,H), cross(N,H)): 1 - cos^2 cancels in float32 near the peak.
// Values are BRDFs in 1/sr.  The whole: base * diffuse_principled + specular_principled.

#ifndef PI
#define PI 3.14159265358979
#endif

// core/shading/tables.py, principled_table: x cosine to the viewer, y roughness; (comp, A) at Specular IOR Level 0.5, and
// above its square Cycles' nodes for the other levels.
uniform sampler2D u_principled_table;

// Constants in capitals (LEVEL_F0: F0 of Specular IOR Level 1) come from gpu/device/programs.py, SHARED_CONSTANTS.

// Normal distribution GGX. Walter, Marschner, Li, Torrance 2007, "Microfacet Models for Refraction", eq. 33.
float D_ggx(float alpha2, float sin2h) {
    float q = sin2h * (1.0 - alpha2) + alpha2; // alpha2 cos^2 + sin^2
    return alpha2 / (PI * q * q);
}

// Mean of D over a disc of half vectors, what a pixel and an emitter make of one, in closed form; sin2h: of its middle,
// radius2: square of its radius.
vec2 D_ggx_disc_ratio(float alpha2, float sin2h, float radius2) {
    float inner = radius2 * (1.0 - alpha2), outside = alpha2 + (sin2h - radius2) * (1.0 - alpha2);
    float root = sqrt(outside * outside + 4.0 * alpha2 * inner);
    // Of two forms of one value the one that does not cancel; above and below the line.
    return outside > 0.0 ? vec2(2.0 * alpha2, PI * root * (root + outside)) : vec2(root - outside, 2.0 * PI * inner * root);
}

float D_ggx_disc(float alpha2, float sin2h, float radius2) {
    vec2 ratio = D_ggx_disc_ratio(alpha2, sin2h, radius2);
    return ratio.x / ratio.y;
}

// D_ggx_disc with its derivative by alpha2.
void D_ggx_disc_d(float alpha2, float sin2h, float radius2, out float value, out float d_alpha2) {
    float inner = radius2 * (1.0 - alpha2), outside = alpha2 + (sin2h - radius2) * (1.0 - alpha2);
    float root = sqrt(outside * outside + 4.0 * alpha2 * inner), inv = 1.0 / root;
    float d_outside = 1.0 - sin2h + radius2;
    float d_root = (outside * d_outside + 2.0 * radius2 * (1.0 - 2.0 * alpha2)) * inv;
    if (outside > 0.0) {
        float both = 1.0 / (root + outside);
        value = 2.0 * alpha2 / PI * inv * both;
        d_alpha2 = 2.0 / PI * inv * both * (1.0 - alpha2 * (d_root * inv + (d_root + d_outside) * both));
    } else {
        float scale = 0.5 / (PI * inner);
        value = (root - outside) * scale * inv;
        d_alpha2 = value / (1.0 - alpha2) + (outside * d_root * inv - d_outside) * scale * inv;
    }
}

// The disc (sin^2 of its middle, square of its radius) that stands for half vectors about a middle: off the normal, where D
// falls one way, their variance in that way is the disc's; near it, the mean of both ways.  half_trace: half of the sum of
// both variances; along: sin2h times the variance in the way to the normal.
vec2 disc_of(float sin2h, float half_trace, float along) {
    float radius2 = 4.0 * (along + half_trace * half_trace) / max(sin2h + half_trace, 1e-30);
    return vec2(max(sin2h + 2.0 * half_trace - 0.5 * radius2, 0.0), radius2);
}

// sqrt(1 + alpha2 tan2). 1 + Lambda_l + Lambda_v is the mean of the two roots. Heitz 2014, eq. 72 and 99.
float lambda_root(float alpha2, float tan2) {
    return sqrt(1.0 + alpha2 * tan2);
}

// Beckmann's distribution exp(-tan^2 / alpha2) / (pi alpha2 cos^4) over such a disc, by the two points of sin^2 that have
// its mean and variance, with its derivative by alpha2. Walter et al. 2007, eq. 25.
void D_beckmann_disc_d(float alpha2, float sin2h, float radius2, out float value, out float d_alpha2) {
    float mean = sin2h + 0.5 * radius2, half_width = sqrt(radius2 * (sin2h + radius2 / 12.0));
    vec2 point = vec2((sin2h * sin2h + radius2 * radius2 / 6.0) / max(mean + half_width, 1e-30), mean + half_width);
    float inv = 1.0 / max(alpha2, ALPHA2_MIN);
    vec2 inv_cos2 = 1.0 / max(1.0 - point, COS2H_MIN);
    vec2 x = point * inv_cos2 * inv;
    vec2 D = exp(-x) * inv_cos2 * inv_cos2 * (inv * 0.5 / PI);
    value = D.x + D.y;
    d_alpha2 = dot(D, x - 1.0) * inv;
}

float D_beckmann_disc(float alpha2, float sin2h, float radius2) {
    float value, unused;
    D_beckmann_disc_d(alpha2, sin2h, radius2, value, unused);
    return value;
}

// Smith's Lambda of Beckmann's distribution with its derivative by alpha2: the rational fit of Walter et al. 2007,
// sec. 5.2, where G1 = n / d is Lambda = d / n - 1; 0 below alpha2 tan2 = 0.39, where Cycles cuts it.
void lambda_beckmann_d(float alpha2, float tan2, out float value, out float d_alpha2) {
    float x = alpha2 * tan2;
    float a = inversesqrt(max(x, 0.39));
    float above = 1.0 + a * (-1.259 + 0.396 * a), inv_below = 1.0 / (a * (3.535 + 2.181 * a));
    float ratio = above * inv_below;
    float by_a = (-1.259 + 0.792 * a - ratio * (3.535 + 4.362 * a)) * inv_below;
    bool shadowed = x >= 0.39;
    value = shadowed ? ratio : 0.0;
    d_alpha2 = shadowed ? -0.5 * a * a * a * tan2 * by_a : 0.0;
}

// 1 + 2 Lambda, to be used as lambda_root, with its derivative by alpha2.
void lambda_root_beckmann_d(float alpha2, float tan2, out float value, out float d_alpha2) {
    lambda_beckmann_d(alpha2, tan2, value, d_alpha2);
    value = 1.0 + 2.0 * value;
    d_alpha2 *= 2.0;
}

float lambda_root_beckmann(float alpha2, float tan2) {
    float value, unused;
    lambda_root_beckmann_d(alpha2, tan2, value, unused);
    return value;
}

// Unpolarised Fresnel reflectance at IOR 1.5. Cook and Torrance 1982, "A Reflectance Model for Computer Graphics".
float F_dielectric(float cos_vh) {
    float g = sqrt(1.25 + cos_vh * cos_vh); // IOR^2 - 1 + cos^2
    float perpendicular = (g - cos_vh) / (g + cos_vh);
    float parallel = (cos_vh * (g + cos_vh) - 1.0) / (cos_vh * (g - cos_vh) + 1.0);
    return 0.5 * perpendicular * perpendicular * (1.0 + parallel * parallel);
}

// Fresnel reflectance at the IOR of a Specular IOR Level (0..1) / that at IOR 1.5, with its derivative by level.
// q = sqrt(F0), IOR = (1 + q) / (1 - q), so IOR^2 - 1 = 4 q / (1 - q)^2 and (g - c) / (g + c) is q p, which does not
// cancel; 0 at level 0.
void F_level_ratio_d(float cos_vh, float level, out float value, out float d_level) {
    float q = sqrt(LEVEL_F0 * level), inv_rest = 1.0 / (1.0 - q);
    float g = sqrt(max(4.0 * q * inv_rest * inv_rest + cos_vh * cos_vh, 1e-12));
    float u = g + cos_vh, inv_u = 1.0 / u;
    float p = 4.0 * inv_rest * inv_rest * inv_u * inv_u;
    float inv_below = 1.0 / (cos_vh * q * p * u + 1.0);
    float parallel = (cos_vh * u - 1.0) * inv_below;
    float share = 1.0 + parallel * parallel, scale = 1.0 / F_dielectric(cos_vh);
    // By g, over q p: the amplitude's 2 c / u^2 and parallel's 2 c (1 - c^2) / below^2.  dg/dlevel has 1/q.
    float by_g = 2.0 * cos_vh * (share * inv_u * inv_u
                                 + q * p * parallel * (1.0 - cos_vh * cos_vh) * inv_below * inv_below);
    value = 0.5 * (q * p) * (q * p) * share * scale;
    d_level = by_g * p * LEVEL_F0 * (1.0 + q) * inv_rest * inv_rest * inv_rest / g * scale;
}

float F_level_ratio(float cos_vh, float level) {
    float value, unused;
    F_level_ratio_d(cos_vh, level, value, unused);
    return value;
}

// u_principled_table between its texels, with the derivative by roughness, where `corner` is the texel of roughness
// and cosine 0 and `last` cells follow it.  By hand: a sampler's filter has only 8 fractional bits.
void interpolate_table(ivec2 corner, float last, float roughness, float cos_v, out vec2 value, out vec2 d_roughness) {
    vec2 at = clamp(vec2(cos_v, roughness), 0.0, 1.0) * last;
    ivec2 cell = ivec2(min(at, last - 1.0));
    vec2 t = at - vec2(cell);
    cell += corner;
    vec4 below = texelFetch(u_principled_table, cell, 0), above = texelFetch(u_principled_table, cell + ivec2(0, 1), 0);
    vec2 low = below.rg + t.x * below.ba, high = above.rg + t.x * above.ba;
    value = mix(low, high, t.y);
    d_roughness = (high - low) * last;
}

// (comp, A) with its derivative by roughness. Kulla and Conty 2017, "Revisiting Physically Based Shading".
void principled_energy_d(float roughness, float cos_v, out vec2 value, out vec2 d_roughness) {
    interpolate_table(ivec2(0), float(TABLE_SIZE - 1), roughness, cos_v, value, d_roughness);
}

// (comp, A): gain of the specular lobe by multiple scattering, and dimming of the diffuse. Kulla and Conty 2017.
vec2 principled_energy(float roughness, float cos_v) {
    vec2 value, unused;
    principled_energy_d(roughness, cos_v, value, unused);
    return value;
}

// principled_energy at a Specular IOR Level 0..1, with its derivatives by roughness and by level, from Cycles' nodes.
// At level 0 it is (1, 0) and starts vertically: below LEVEL_MIN the derivative by level is LEVEL_MIN's.
void principled_energy_level_d(
    float roughness, float cos_v, float level, out vec2 value, out vec2 d_roughness, out vec2 d_level
) {
    float at_least = max(level, LEVEL_MIN);
    float f0 = LEVEL_F0 * level, q = sqrt(f0), q_floor = sqrt(LEVEL_F0 * at_least);
    float z = float(FRESNEL_NODES - 1) * sqrt(q);
    int k = min(int(z), FRESNEL_SLICES - 2);
    vec2 lobe, d_lobe, slices, d_slices; // (E1, Eavg); s of slices k and k + 1
    interpolate_table(ivec2(0, TABLE_SIZE), float(LOBE_NODES - 1), roughness, cos_v, lobe, d_lobe);
    interpolate_table(ivec2(LOBE_NODES + FRESNEL_NODES * k, TABLE_SIZE), float(FRESNEL_NODES - 1), roughness, cos_v,
                      slices, d_slices);
    float s = mix(slices.x, slices.y, z - float(k)), d_s = mix(d_slices.x, d_slices.y, z - float(k));
    float s_by_level = (slices.y - slices.x) * float(FRESNEL_NODES - 1) * sqrt(q_floor) / (4.0 * at_least);
    // Kulla and Conty's (n - 1) / (4.08567 + 1.00071 n), n = (1 + q) / (1 - q), and its derivative.
    float fss = 2.0 * q / (5.08638 - 3.08496 * q);
    float inv = 1.0 / (5.08638 - 3.08496 * q_floor);
    float fss_by_level = 10.17276 * inv * inv * 0.5 * LEVEL_F0 / q_floor;
    float inv_below = 1.0 / (1.0 - fss * (1.0 - lobe.y));
    float fms = fss * lobe.y * inv_below, fms_by_mean = fss * (1.0 - fss) * inv_below * inv_below;
    float fms_by_level = lobe.y * inv_below * inv_below * fss_by_level;
    float inv_e1 = 1.0 / lobe.x, loss = 1.0 - lobe.x;
    float gained = lobe.x + fms * loss, fresnel = f0 + (1.0 - f0) * s; // gained: E1 comp
    float gained_by_r = d_lobe.x * (1.0 - fms) + fms_by_mean * d_lobe.y * loss;
    value = vec2(1.0 + fms * loss * inv_e1, fresnel * gained);
    d_roughness = vec2((fms_by_mean * d_lobe.y * loss - fms * d_lobe.x * inv_e1) * inv_e1,
                       (1.0 - f0) * d_s * gained + fresnel * gained_by_r);
    d_level = vec2(fms_by_level * loss * inv_e1, (LEVEL_F0 * (1.0 - s) + (1.0 - f0) * s_by_level) * gained
                                                 + fresnel * fms_by_level * loss);
}

vec2 principled_energy_level(float roughness, float cos_v, float level) {
    vec2 value, unused, unused_too;
    principled_energy_level_d(roughness, cos_v, level, value, unused, unused_too);
    return value;
}

// (E1, Eavg) with its derivative by roughness: albedo of the lobe without Fresnel, and its mean over the hemisphere.
void metal_energy_d(float roughness, float cos_v, out vec2 value, out vec2 d_roughness) {
    interpolate_table(ivec2(0, TABLE_SIZE), float(LOBE_NODES - 1), roughness, cos_v, value, d_roughness);
}

vec2 metal_energy(float roughness, float cos_v) {
    vec2 value, unused;
    metal_energy_d(roughness, cos_v, value, unused);
    return value;
}

// Gain of a metal's lobe by multiple scattering at a base colour, with its derivatives by roughness (`d_energy`: that
// of energy) and by base colour. Kulla and Conty 2017; Schlick's reflectance has the mean b + (1 - b) / 21.
void metal_gain_d(float base, vec2 energy, vec2 d_energy, out float value, out float d_roughness, out float d_base) {
    float fss = base + (1.0 - base) / 21.0, inv_below = 1.0 / (1.0 - fss * (1.0 - energy.y));
    float fms = fss * energy.y * inv_below, more = 1.0 / energy.x - 1.0;
    value = 1.0 + fms * more;
    d_roughness = fss * (1.0 - fss) * inv_below * inv_below * d_energy.y * more
                - fms * d_energy.x / (energy.x * energy.x);
    d_base = 20.0 / 21.0 * energy.y * inv_below * inv_below * more;
}

float metal_gain(float base, vec2 energy) {
    float value, unused, unused_too;
    metal_gain_d(base, energy, vec2(0.0), value, unused, unused_too);
    return value;
}

// (1 - V.H)^5: a metal of base colour b reflects b + (1 - b) of it. Schlick 1994, "An Inexpensive BRDF Model", eq. 15.
float F_schlick(float cos_vh) {
    float c = 1.0 - cos_vh, c2 = c * c;
    return c2 * c2 * c;
}

// D F comp / (4 cos_l cos_v (1 + Lambda_l + Lambda_v)). Heitz 2014, "Understanding the Masking-Shadowing Function".
float specular_principled(float roughness, float sin2h, float radius2, float cos_l, float cos_v, float cos_vh) {
    float alpha2 = roughness * roughness * roughness * roughness;
    float roots = lambda_root(alpha2, 1.0 / (cos_l * cos_l) - 1.0) + lambda_root(alpha2, 1.0 / (cos_v * cos_v) - 1.0);
    return D_ggx_disc(alpha2, sin2h, radius2) * F_dielectric(cos_vh) * principled_energy(roughness, cos_v).x
         / (2.0 * cos_l * cos_v * roots);
}

// The same with Beckmann's distribution, at IOR 1.5 and without comp. Walter et al. 2007, eq. 20.
float specular_beckmann(float roughness, float sin2h, float radius2, float cos_l, float cos_v, float cos_vh) {
    float alpha2 = roughness * roughness * roughness * roughness;
    float roots = lambda_root_beckmann(alpha2, 1.0 / (cos_l * cos_l) - 1.0)
                + lambda_root_beckmann(alpha2, 1.0 / (cos_v * cos_v) - 1.0);
    return D_beckmann_disc(alpha2, sin2h, radius2) * F_dielectric(cos_vh) / (2.0 * cos_l * cos_v * roots);
}

// (1 - A) / pi: what the specular layer leaves to a white diffuse; depends on the view only, as in Cycles.
float diffuse_principled(float roughness, float cos_v) {
    return (1.0 - principled_energy(roughness, cos_v).y) / PI;
}

// What a coat (weight, roughness) leaves of all that lies below it, toward the viewer: the layering of Cycles.
float left_by_coat(vec2 coat, float cos_v) {
    return 1.0 - coat.x * principled_energy(coat.y, cos_v).y;
}

// The diffuse of a Diffuse Roughness: over what a smooth one reflects, first + second * rough_bounce.  The improved
// Oren-Nayar model with energy preservation; brdf.py has the references.
float fujii_scale(float roughness) {
    return 1.0 / (PI + roughness * (0.5 * PI - 2.0 / 3.0));
}

float fujii(float cosine) {
    float c = clamp(cosine, 1e-6, 1.0), s = sqrt(1.0 - c * c);
    return s * (atan(s, c) - 2.0 / 3.0 - s * c) + 2.0 / 3.0 * s / c * (1.0 - s * s * s);
}

vec2 rough_parts(float cos_l, float cos_v, float cos_lv, float roughness) {
    float a = fujii_scale(roughness), t = cos_lv - cos_l * cos_v;
    if (t > 0.0) t /= max(cos_l, cos_v);
    float lost_l = 1.0 - a * (PI + roughness * fujii(cos_l)), lost_v = 1.0 - a * (PI + roughness * fujii(cos_v));
    return vec2(PI * a * (1.0 + roughness * t), lost_l * lost_v);
}

vec3 rough_bounce(vec3 base, float roughness) {
    float mean = fujii_scale(roughness) * (PI + roughness * (2.0 * PI - 5.6) / 3.0);
    return base * base * mean / (max(1.0 - mean, ROUGH_LOST) * (1.0 - base * (1.0 - mean)));
}

// What one lamp adds to rough_parts of all light, less 1.  lobe: sin2h, radius2, cos_l, F / (2 cos_l cos_v) * share.
vec2 rough_share(vec4 lobe, float cos_v, float roughness) {
    float cos_l = clamp(lobe.z, 1e-3, 1.0), both = cos_l + cos_v;
    float far = both * both / max(1.0 - lobe.x, 1e-6);  // |L + V|^2
    float share = lobe.w * 2.0 * cos_l * cos_v / F_dielectric(min(0.5 * sqrt(far), 1.0));
    return share * (rough_parts(cos_l, cos_v, clamp(0.5 * far - 1.0, -1.0, 1.0), roughness) - vec2(1.0, 0.0));
}
