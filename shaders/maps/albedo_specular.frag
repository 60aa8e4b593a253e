// Specular radiance per irradiance of one light at every pixel, at the roughness found; lights add up.
#include "include/lobes.glsl"
uniform sampler2D u_position;   // pixel grid
uniform sampler2D u_normal;
uniform sampler2D u_uv;
uniform sampler2D u_lobe;
uniform vec3 u_channel;
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
    Found found = found_at(texelFetch(u_uv, at, 0).xy);
    o_specular.rgb = u_channel * specular_of(found, cos_v, texelFetch(u_lobe, at, 0));
    o_specular.a = 0.0;
}
