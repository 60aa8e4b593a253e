// Specular radiance per irradiance of one light at every pixel, at the roughness found; lights add up.
// ROUGH_DIFFUSE: and in o_rough what a rough diffuse adds to a smooth one's: 1/sr with SHOWN; else for each channel over
// the smooth one's, and in alpha the factor of rough_bounce.
#include "include/lobes.glsl"
uniform sampler2D u_position;   // pixel grid
uniform sampler2D u_normal;
uniform sampler2D u_uv;
uniform sampler2D u_lobe;
uniform vec3 u_channel;
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

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec4 p = texelFetch(u_position, at, 0);
    if (p.w < 0.5) discard;
    vec3 V = u_orthographic ? -u_camera_forward : normalize(u_camera_position - p.xyz);
    float cos_v = clamp(dot(texelFetch(u_normal, at, 0).xyz, V), 1e-3, 1.0);
    Found found = found_at(texelFetch(u_uv, at, 0).xy);
    o_specular.rgb = u_channel * specular_of(found, cos_v, texelFetch(u_lobe, at, 0));
    o_specular.a = 0.0;
#ifdef METALLIC
    float metallic = metallic_at(texelFetch(u_uv, at, 0).xy);
    vec2 metal = metallic * metal_of(found, cos_v, texelFetch(u_lobe, at, 0));
    o_specular.rgb *= 1.0 - metallic;
#ifdef SHOWN
    vec3 base = texelFetch(u_shown, at, 0).rgb, gain, unused;
    metal_gain_of(found, cos_v, base, gain, unused);
    o_specular.rgb += u_channel * gain * (metal.x + base * metal.y);
#else
    float share = dot(u_channel, vec3(1.0 / 3.0));
    o_specular.a = share * metal.x;
    o_metal = vec4(u_channel * metal.y, share * metal.y);
#endif
#endif
#ifdef COAT
    vec2 coat = coat_at(texelFetch(u_uv, at, 0).xy);
    float left = left_by_coat(coat, cos_v);
    o_specular *= left;
    o_specular.rgb += u_channel * coat_of(coat, cos_v, texelFetch(u_lobe, at, 0));
#if defined(METALLIC) && !defined(SHOWN)
    o_metal *= left;
#endif
#endif
#ifdef ROUGH_DIFFUSE
    float rough = rough_at(texelFetch(u_uv, at, 0).xy);
    vec2 more = rough_share(texelFetch(u_lobe, at, 0), cos_v, rough);
#ifdef SHOWN
    vec3 colour = texelFetch(u_shown, at, 0).rgb;
    vec3 added = more.x + more.y * rough_bounce(colour, rough);
    o_rough = vec4(u_channel * colour * diffuse_of(found, cos_v) * added, 0.0);
#else
    o_rough = vec4(u_channel * more.x, dot(u_channel, vec3(1.0 / 3.0)) * more.y);
#endif
#endif
}
