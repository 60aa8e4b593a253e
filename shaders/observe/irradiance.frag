// Irradiance of one light on every pixel, added to that of the view's other lights.
#include "include/lights.glsl"
#include "include/pixel.glsl"
uniform sampler2D u_lit;   // share of the light that arrives
uniform vec3 u_power;

layout(location = 0) out vec4 o_irradiance;  // RGB, shadow edge (> 0)

const float MIN_COS_L = 0.08;  // the terminator: there the irradiance is wrong by the facets' own error

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    Pixel pixel;
    if (!load_pixel(at, pixel)) discard;
    float e = 0.0;
    for (int j = 0; j < 4; j++) {
        vec3 P, N;
        footprint_point(pixel, j, P, N);
        e += 0.25 * light_irradiance(P, N);
    }
    float least = 1.0, most = 0.0;
    for (int y = -1; y <= 1; y++) for (int x = -1; x <= 1; x++) {
        ivec2 near = clamp(at + ivec2(x, y), ivec2(0), textureSize(u_lit, 0) - 1);
        if (texelFetch(u_position, near, 0).w < 0.5) continue;
        float lit = texelFetch(u_lit, near, 0).r;
        least = min(least, lit);
        most = max(most, lit);
    }
    float lit = texelFetch(u_lit, at, 0).r;
    float weight;
    float cos_l = dot(pixel.N, normalize(light_sample(pixel.P, 0, 1, weight)));
    bool edge = e > 0.0 && (most - least > 0.02 || cos_l < MIN_COS_L);
    o_irradiance = vec4(u_power * e * lit, edge ? 1.0 : 0.0);
}
