// Cycles' Principled BSDF: metallic 0, IOR 1.5, multiscatter GGX.  Twin: irpso_addon/core/brdf.py.
//
// alpha = roughness^2, alpha2 = alpha^2; cos_l, cos_v: N.L and N.V; cos_vh: V.H, H the half vector.
// sin2h: 1 - (N.H)^2, from dot(cross(N,H), cross(N,H)): 1 - cos^2 cancels in float32 near the peak.
// Values are BRDFs in 1/sr.  The whole: base * diffuse_principled + specular_principled.

#ifndef PI
#define PI 3.14159265358979
#endif

uniform sampler2D u_principled_table; // core/tables.py: x cosine to the viewer, y roughness; (comp, A)

// Normal distribution GGX. Walter, Marschner, Li, Torrance 2007, "Microfacet Models for Refraction", eq. 33.
float D_ggx(float alpha2, float sin2h) {
    float q = sin2h * (1.0 - alpha2) + alpha2; // alpha2 cos^2 + sin^2
    return alpha2 / (PI * q * q);
}

// Mean of D over sin2h +- spread (a standard deviation): two-point Gauss-Hermite rule over pixel and emitter.
float D_ggx_spread(float alpha2, float sin2h, float spread) {
    float half_width = min(spread, sin2h); // keeps the mean where the lower point would fall below 0
    return 0.5 * (D_ggx(alpha2, sin2h - half_width) + D_ggx(alpha2, sin2h + half_width));
}

// D_ggx_spread with its derivative by alpha2: dD/dalpha2 = (s (1 + alpha2) - alpha2) / (pi q^3).
void D_ggx_spread_d(float alpha2, float sin2h, float spread, out float value, out float d_alpha2) {
    float half_width = min(spread, sin2h);
    float low = sin2h - half_width, high = sin2h + half_width;
    float inv_low = 1.0 / (low * (1.0 - alpha2) + alpha2), inv_high = 1.0 / (high * (1.0 - alpha2) + alpha2);
    vec2 inv2 = vec2(inv_low * inv_low, inv_high * inv_high);
    value = alpha2 * (inv2.x + inv2.y) * (0.5 / PI);
    d_alpha2 = ((low * (1.0 + alpha2) - alpha2) * inv2.x * inv_low
              + (high * (1.0 + alpha2) - alpha2) * inv2.y * inv_high) * (0.5 / PI);
}

// sqrt(1 + alpha2 tan2). 1 + Lambda_l + Lambda_v is the mean of the two roots. Heitz 2014, eq. 72 and 99.
float lambda_root(float alpha2, float tan2) {
    return sqrt(1.0 + alpha2 * tan2);
}

// Unpolarised Fresnel reflectance at IOR 1.5. Cook and Torrance 1982, "A Reflectance Model for Computer Graphics".
float F_dielectric(float cos_vh) {
    float g = sqrt(1.25 + cos_vh * cos_vh); // IOR^2 - 1 + cos^2
    float perpendicular = (g - cos_vh) / (g + cos_vh);
    float parallel = (cos_vh * (g + cos_vh) - 1.0) / (cos_vh * (g - cos_vh) + 1.0);
    return 0.5 * perpendicular * perpendicular * (1.0 + parallel * parallel);
}

// (comp, A) with its derivative by roughness. Kulla and Conty 2017, "Revisiting Physically Based Shading".
void principled_energy_d(float roughness, float cos_v, out vec2 value, out vec2 d_roughness) {
    // Interpolated by hand: a sampler's filter has only 8 fractional bits.
    vec2 last = vec2(textureSize(u_principled_table, 0) - 1);
    vec2 at = clamp(vec2(cos_v, roughness), 0.0, 1.0) * last;
    ivec2 cell = ivec2(min(at, last - 1.0));
    vec2 t = at - vec2(cell);
    vec2 low = mix(texelFetch(u_principled_table, cell, 0).rg,
                   texelFetch(u_principled_table, cell + ivec2(1, 0), 0).rg, t.x);
    vec2 high = mix(texelFetch(u_principled_table, cell + ivec2(0, 1), 0).rg,
                    texelFetch(u_principled_table, cell + ivec2(1, 1), 0).rg, t.x);
    value = mix(low, high, t.y);
    d_roughness = (high - low) * last.y;
}

// (comp, A): gain of the specular lobe by multiple scattering, and dimming of the diffuse. Kulla and Conty 2017.
vec2 principled_energy(float roughness, float cos_v) {
    vec2 value, unused;
    principled_energy_d(roughness, cos_v, value, unused);
    return value;
}

// D F comp / (4 cos_l cos_v (1 + Lambda_l + Lambda_v)). Heitz 2014, "Understanding the Masking-Shadowing Function".
float specular_principled(float roughness, float sin2h, float spread, float cos_l, float cos_v, float cos_vh) {
    float alpha2 = roughness * roughness * roughness * roughness;
    float roots = lambda_root(alpha2, 1.0 / (cos_l * cos_l) - 1.0) + lambda_root(alpha2, 1.0 / (cos_v * cos_v) - 1.0);
    return D_ggx_spread(alpha2, sin2h, spread) * F_dielectric(cos_vh) * principled_energy(roughness, cos_v).x
         / (2.0 * cos_l * cos_v * roots);
}

// (1 - A) / pi: what the specular layer leaves to a white diffuse; depends on the view only, as in Cycles.
float diffuse_principled(float roughness, float cos_v) {
    return (1.0 - principled_energy(roughness, cos_v).y) / PI;
}
