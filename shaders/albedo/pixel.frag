// Albedo that a camera's pixel shows, at the roughness found: numerator and denominator of the
// least-squares albedo of one view, added over the camera's views and each view's lights.
#include "include/brdf.glsl"
uniform sampler2D u_position;   // pixel grid
uniform sampler2D u_normal;
uniform sampler2D u_uv;
uniform sampler2D u_colour;     // f (1/sr), weight
uniform sampler2D u_roughness;  // texel grid, holes filled
uniform sampler2D u_lobe;       // of one light
uniform bool u_first_light;
uniform int u_lambert_slots;    // bit s: slot s has no lobe
uniform vec3 u_camera_position;
uniform vec3 u_camera_forward;
uniform bool u_orthographic;

layout(location = 0) out vec4 o_albedo;  // weighted albedo sum, weight

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec4 p = texelFetch(u_position, at, 0), colour = texelFetch(u_colour, at, 0);
    if (p.w < 0.5 || colour.a <= 0.0) discard;
    vec3 V = u_orthographic ? -u_camera_forward : normalize(u_camera_position - p.xyz);
    vec4 normal = texelFetch(u_normal, at, 0);
    float cos_v = clamp(dot(normal.xyz, V), 1e-3, 1.0);
    float r = texture(u_roughness, texelFetch(u_uv, at, 0).xy).r;
    float alpha2 = r * r * r * r;
    vec2 energy = principled_energy(r, cos_v);
    float diffuse = (1.0 - energy.y) / PI;
    float root_v = lambda_root(alpha2, 1.0 / (cos_v * cos_v) - 1.0);
    vec4 g = texelFetch(u_lobe, at, 0);
    float root_l = lambda_root(alpha2, 1.0 / (g.z * g.z + 1e-12) - 1.0);
    float s = energy.x * g.w * D_ggx_spread(alpha2, g.x, g.y) / (root_l + root_v);
    if ((u_lambert_slots >> min(int(normal.w), 31) & 1) == 1) {
        diffuse = 1.0 / PI;
        s = 0.0;
    }
    float first = u_first_light ? 1.0 : 0.0;
    o_albedo = colour.a * diffuse * vec4(first * colour.rgb - s, first * diffuse);
}
