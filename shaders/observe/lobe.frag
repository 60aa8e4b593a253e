// What the specular lobe needs of one light at every pixel: mean and spread of sin^2(theta_h) over
// the pixel's footprint and the emitter, the cosine to the light, and the lobe's factor.
#include "include/brdf.glsl"
#include "include/lights.glsl"
#include "include/pixel.glsl"
uniform sampler2D u_lit;
uniform sampler2D u_irradiance;  // of all the view's lights
uniform vec3 u_power;
uniform int u_light_points;
uniform vec3 u_channel;          // which channels' shares of the light count

layout(location = 0) out vec4 o_lobe;  // sin2h, spread, cos_l, F / (2 cos_l cos_v) * E_light / E_view

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    Pixel pixel;
    if (!load_pixel(at, pixel)) discard;
    float sum = 0.0, mean = 0.0, square = 0.0, cos_l = 0.0, fresnel = 0.0, cos_v = 0.0, e = 0.0;
    for (int j = 0; j < 4; j++) {
        vec3 P, N;
        footprint_point(pixel, j, P, N);
        vec3 V = toward_camera(P);
        cos_v += 0.25 * dot(N, V);
        e += 0.25 * light_irradiance(P, N);
        for (int i = 0; i < u_light_points; i++) {
            float weight;
            vec3 L = normalize(light_sample(P, i, u_light_points, weight));
            float nl = dot(N, L);
            weight *= max(nl, 0.0);
            vec3 H = normalize(L + V);
            vec3 off = cross(N, H);
            float s = dot(off, off);
            sum += weight;
            mean += weight * s;
            square += weight * s * s;
            cos_l += weight * nl;
            fresnel += weight * F_dielectric(dot(V, H));
        }
    }
    if (sum <= 0.0 || cos_v <= 0.0) discard;
    mean /= sum;
    cos_l = clamp(cos_l / sum, 1e-3, 1.0);
    cos_v = clamp(cos_v, 1e-3, 1.0);
    float spread = sqrt(max(square / sum - mean * mean, 0.0));
    float lit = texelFetch(u_lit, at, 0).r;
    vec3 all = texelFetch(u_irradiance, at, 0).rgb;
    float share = dot(u_power * e * lit, u_channel) / max(dot(all, u_channel), 1e-20);
    o_lobe = vec4(mean, spread, cos_l, fresnel / sum / (2.0 * cos_l * cos_v) * share);
}
