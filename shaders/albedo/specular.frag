// Specular radiance per irradiance of one light at every pixel, at the roughness found; lights add up.
#include "include/brdf.glsl"
uniform sampler2D u_position;   // pixel grid
uniform sampler2D u_normal;
uniform sampler2D u_uv;
uniform sampler2D u_lobe;
uniform vec3 u_channel;
uniform sampler2D u_roughness;  // texel grid, holes filled
uniform vec3 u_camera_position;
uniform vec3 u_camera_forward;
uniform bool u_orthographic;

layout(location = 0) out vec4 o_specular;  // 1/sr

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec4 p = texelFetch(u_position, at, 0);
    if (p.w < 0.5) discard;
    vec3 V = u_orthographic ? -u_camera_forward : normalize(u_camera_position - p.xyz);
    float cos_v = clamp(dot(texelFetch(u_normal, at, 0).xyz, V), 1e-3, 1.0);
    float r = texture(u_roughness, texelFetch(u_uv, at, 0).xy).r;
    float alpha2 = r * r * r * r;
    vec4 lobe = texelFetch(u_lobe, at, 0);
    float roots = lambda_root(alpha2, 1.0 / (lobe.z * lobe.z + 1e-12) - 1.0)
                + lambda_root(alpha2, 1.0 / (cos_v * cos_v) - 1.0);
    o_specular.rgb = u_channel * lobe.w * principled_energy(r, cos_v).x * D_ggx_spread(alpha2, lobe.x, lobe.y) / roots;
    o_specular.a = 0.0;
}
