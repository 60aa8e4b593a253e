// What a camera's pixels show of the base colour found, averaged over the footprint, through the lobes found: the
// diffuse part of the prediction, 1/sr.
#include "include/lobes.glsl"
uniform sampler2D u_position;  // pixel grid
uniform sampler2D u_normal;
uniform sampler2D u_uv;
uniform sampler2D u_uv_slope;
uniform sampler2D u_base;      // texel grid, holes filled
uniform float u_footprint;
uniform vec3 u_camera_position;
uniform vec3 u_camera_forward;
uniform bool u_orthographic;

layout(location = 0) out vec4 o_diffuse;  // RGB, cos_v
#if defined(METALLIC) || defined(ROUGH_DIFFUSE)
layout(location = 1) out vec4 o_base;     // a metal's lobe and a rough diffuse are others for each view
#endif

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec4 p = texelFetch(u_position, at, 0);
    if (p.w < 0.5) discard;
    vec3 V = u_orthographic ? -u_camera_forward : normalize(u_camera_position - p.xyz);
    float cos_v = clamp(dot(texelFetch(u_normal, at, 0).xyz, V), 1e-3, 1.0);
    vec2 uv = texelFetch(u_uv, at, 0).xy;
    vec4 slope = texelFetch(u_uv_slope, at, 0);
    vec3 mean = vec3(0.0);
    for (int j = 0; j < 16; j++) {
        vec2 d = (vec2(float(j & 3), float(j >> 2)) - 1.5) * 0.25 * u_footprint;
        mean += texture(u_base, uv + d.x * slope.xy + d.y * slope.zw).rgb / 16.0;
    }
    o_diffuse = vec4(mean * diffuse_of(found_at(uv), cos_v), cos_v);
#ifdef COAT
    o_diffuse.rgb *= left_by_coat(coat_at(uv), cos_v);
#endif
#ifdef METALLIC
    o_diffuse.rgb *= 1.0 - metallic_at(uv);
#endif
#if defined(METALLIC) || defined(ROUGH_DIFFUSE)
    o_base = vec4(mean, 1.0);
#endif
}
