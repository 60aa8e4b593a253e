// Specular radiance per irradiance of a view's environment at every pixel, at the roughness found: as albedo_specular.frag
// of a light, but each channel has its own.
#include "include/lobes.glsl"
#include "include/node_curve.glsl"
uniform sampler2D u_position;   // pixel grid
uniform sampler2D u_normal;
uniform sampler2D u_uv;
uniform sampler2D u_nodes;      // ENVIRONMENT_COLUMNS nodes side by side, rows of them one above the other
uniform vec3 u_camera_position;
uniform vec3 u_camera_forward;
uniform bool u_orthographic;

#ifdef SHOWN
uniform sampler2D u_shown;  // pixel grid: base colour
#endif

layout(location = 0) out vec4 o_specular;  // 1/sr; with METALLIC alone, alpha: what a black metal adds to o_metal's
#if defined(METALLIC) && !defined(SHOWN)
layout(location = 1) out vec4 o_metal;     // what a white metal returns beyond a black one, without gain; alpha: mean
#endif
#ifdef ROUGH_DIFFUSE
#if defined(METALLIC) && !defined(SHOWN)
layout(location = 2) out vec4 o_rough;
#else
layout(location = 1) out vec4 o_rough;
#endif
#endif

vec4 node(ivec2 at, int k) {
    return texelFetch(u_nodes, at + textureSize(u_position, 0) * ivec2(k % ENVIRONMENT_COLUMNS, k / ENVIRONMENT_COLUMNS), 0);
}

// Of a lobe at IOR 1.5, RGB, without the gain by multiple scattering; V.H at which Fresnel's reflectance is the lobe's.
vec4 around(ivec2 at, float r) {
    NodePlace p = node_place(r);
    vec4 low = node(at, p.node), high = node(at, p.node + 1);
    vec3 least = vec3(ENVIRONMENT_LEAST), value, unused;
    node_curve(p, log(max(node(at, max(p.node - 1, 0)).rgb, least)), log(max(low.rgb, least)), log(max(high.rgb, least)),
               log(max(node(at, min(p.node + 2, ENVIRONMENT_NODES - 1)).rgb, least)), value, unused);
    return vec4(value, clamp(mix(low.a, high.a, p.t), 0.0, 1.0));
}

vec3 lobe_around(ivec2 at, Found f, float r, float cos_v) {
    vec4 s = around(at, r);
#ifdef SPECULAR
    s.rgb *= F_level_ratio(s.a, f.level);
#endif
    return s.rgb * energy_of(r, cos_v, f.level).x;
}

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec4 p = texelFetch(u_position, at, 0);
    if (p.w < 0.5) discard;
    vec3 V = u_orthographic ? -u_camera_forward : normalize(u_camera_position - p.xyz);
    float cos_v = clamp(dot(texelFetch(u_normal, at, 0).xyz, V), 1e-3, 1.0);
    vec2 uv = texelFetch(u_uv, at, 0).xy;
    Found found = found_at(uv);
    vec3 s = lobe_around(at, found, found.r.x, cos_v);
#ifndef ONE_LOBE
    if (found.r.y != found.r.x) s = mix(lobe_around(at, found, found.r.y, cos_v), s, found.weight);
#endif
    o_specular = vec4(s, 0.0);
#ifdef METALLIC
    float metallic = metallic_at(uv);
    vec4 seen = around(at, found.r.x);
    vec3 lobe = metallic / F_dielectric(seen.a) * seen.rgb, black = F_schlick(seen.a) * lobe, white = lobe - black;
    o_specular.rgb *= 1.0 - metallic;
#ifdef SHOWN
    vec3 base = texelFetch(u_shown, at, 0).rgb, gain, unused;
    metal_gain_of(found, cos_v, base, gain, unused);
    o_specular.rgb += gain * (black + base * white);
#else
    o_specular.a = dot(black, vec3(1.0 / 3.0));
    o_metal = vec4(white, dot(white, vec3(1.0 / 3.0)));
#endif
#endif
#ifdef COAT
    vec2 coat = coat_at(uv);
    float left = left_by_coat(coat, cos_v);
    o_specular *= left;
    o_specular.rgb += coat.x * principled_energy(coat.y, cos_v).x * around(at, coat.y).rgb;
#if defined(METALLIC) && !defined(SHOWN)
    o_metal *= left;
#endif
#endif
#ifdef ROUGH_DIFFUSE
    o_rough = vec4(0.0);  // as of a smooth one
#endif
}
