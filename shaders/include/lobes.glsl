// The material that the search found, looked up at a pixel: two lobes (a single one: equal roughnesses), which may
// be Principled or Beckmann's (NDF_BECKMANN), at a Specular IOR Level that is a map with SPECULAR, else 0.5, and a
// Metallic that is one with METALLIC, else 0, under a coat that is one with COAT, above a diffuse whose Diffuse
// Roughness is one with ROUGH_DIFFUSE, else 0.  With ONE_LOBE no texel has two.
#include "include/brdf.glsl"
uniform sampler2D u_lobes;  // texel grid, holes filled: roughness1, roughness2, weight of lobe 1
#ifdef SPECULAR
uniform sampler2D u_level;
#endif

#ifdef METALLIC
uniform sampler2D u_metallic;  // 0 where there are two lobes
float metallic_at(vec2 uv) { return texture(u_metallic, uv).r; }
#endif

#ifdef COAT
uniform sampler2D u_coat;  // weight, roughness
vec2 coat_at(vec2 uv) { return texture(u_coat, uv).rg; }
#endif

#ifdef ROUGH_DIFFUSE
uniform sampler2D u_rough;
float rough_at(vec2 uv) { return texture(u_rough, uv).r; }
#endif

struct Found { vec2 r; float weight, level; };

Found found_at(vec2 uv) {
    vec3 lobes = texture(u_lobes, uv).rgb;
#ifdef SPECULAR
    return Found(lobes.rg, lobes.b, texture(u_level, uv).r);
#else
    return Found(lobes.rg, lobes.b, 0.5);
#endif
}

// With NDF_BECKMANN, whether a place has Beckmann's lobes: other materials of the object have one Principled lobe.
bool is_beckmann(Found f) { return f.r.x != f.r.y || f.weight < 1.0; }

// (comp, A) of one roughness of the Principled BSDF.
vec2 energy_of(float r, float cos_v, float level) {
#if defined(SPECULAR)
    vec2 value, d_roughness, d_level;
    principled_energy_level_d(r, cos_v, level, value, d_roughness, d_level);
    return value;
#else
    return principled_energy(r, cos_v);
#endif
}

// Reflectance of the diffuse below the lobes for white, 1/sr.
float diffuse_of(Found f, float cos_v) {
#ifdef NDF_BECKMANN
    if (is_beckmann(f)) return 1.0 / PI;
#endif
    float taken = energy_of(f.r.x, cos_v, f.level).y;
#ifndef ONE_LOBE
    if (f.r.y != f.r.x) taken = mix(energy_of(f.r.y, cos_v, f.level).y, taken, f.weight);
#endif
    return (1.0 - taken) / PI;
}

// D / (roots) of one roughness: with the lobe's factor, the specular radiance per irradiance.
float lobe_shape(Found f, float r, float cos_v, vec4 lobe) {
    float alpha2 = r * r * r * r, tan2_l = 1.0 / (lobe.z * lobe.z + 1e-12) - 1.0, tan2_v = 1.0 / (cos_v * cos_v) - 1.0;
#ifdef NDF_BECKMANN
    if (is_beckmann(f)) {
        float d, root_l, root_v, unused;
        D_beckmann_disc_d(alpha2, lobe.x, lobe.y, d, unused);
        lambda_root_beckmann_d(alpha2, tan2_l, root_l, unused);
        lambda_root_beckmann_d(alpha2, tan2_v, root_v, unused);
        return d / (root_l + root_v);
    }
#endif
    return energy_of(r, cos_v, f.level).x * D_ggx_disc(alpha2, lobe.x, lobe.y)
         / (lambda_root(alpha2, tan2_l) + lambda_root(alpha2, tan2_v));
}

// Specular radiance per irradiance; lobe: sin2h, spread, cos_l, factor, as observe/lobe.frag leaves it.
float specular_of(Found f, float cos_v, vec4 lobe) {
    float s = lobe_shape(f, f.r.x, cos_v, lobe);
#ifndef ONE_LOBE
    if (f.r.y != f.r.x) s = mix(lobe_shape(f, f.r.y, cos_v, lobe), s, f.weight);
#endif
#ifdef SPECULAR
    float cos_vh = (lobe.z + cos_v) / (2.0 * sqrt(max(1.0 - lobe.x, 1e-6)));  // from N.H = (N.L + N.V) / |L + V|
    s *= F_level_ratio(min(cos_vh, 1.0), f.level);
#endif
    return s * lobe.w;
}

#ifdef METALLIC
// Of a metal, what its lobe returns per irradiance, without the gain by multiple scattering: (black, white - black).
vec2 metal_of(Found f, float cos_v, vec4 lobe) {
    float alpha2 = f.r.x * f.r.x * f.r.x * f.r.x;
    float tan2_l = 1.0 / (lobe.z * lobe.z + 1e-12) - 1.0, tan2_v = 1.0 / (cos_v * cos_v) - 1.0;
    float cos_vh = min((lobe.z + cos_v) / (2.0 * sqrt(max(1.0 - lobe.x, 1e-6))), 1.0), black = F_schlick(cos_vh);
    float s = lobe.w / F_dielectric(cos_vh) * D_ggx_disc(alpha2, lobe.x, lobe.y)
            / (lambda_root(alpha2, tan2_l) + lambda_root(alpha2, tan2_v));
    return s * vec2(black, 1.0 - black);
}

// The gain of each channel, with its derivative by base colour.
void metal_gain_of(Found f, float cos_v, vec3 base, out vec3 gain, out vec3 d_base) {
    vec2 energy = metal_energy(f.r.x, cos_v);
    float unused;
    for (int c = 0; c < 3; c++) metal_gain_d(base[c], energy, vec2(0.0), gain[c], unused, d_base[c]);
}
#endif

#ifdef COAT
// What the coat reflects per irradiance.
float coat_of(vec2 coat, float cos_v, vec4 lobe) {
    float alpha2 = coat.y * coat.y * coat.y * coat.y;
    float tan2_l = 1.0 / (lobe.z * lobe.z + 1e-12) - 1.0, tan2_v = 1.0 / (cos_v * cos_v) - 1.0;
    return coat.x * principled_energy(coat.y, cos_v).x * lobe.w * D_ggx_disc(alpha2, lobe.x, lobe.y)
         / (lambda_root(alpha2, tan2_l) + lambda_root(alpha2, tan2_v));
}
#endif
