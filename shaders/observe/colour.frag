// A view's pixel as an observation: reflected radiance per irradiance, and how far to trust it.
#include "include/pixel.glsl"
uniform sampler2D u_image;       // radiance, quality (0: unusable, 1: good, between: partly covered)
uniform sampler2D u_irradiance;  // of the view's lights; a = shadow edge
uniform float u_level;           // typical radiance of the views
uniform float u_edge_weight;
uniform float u_dark;            // irradiance below this share of the level is as good as none

layout(location = 0) out vec4 o_colour;  // radiance / irradiance (1/sr), quality (about 1: good)

const float NO_LIGHT = -1e3;
const float MIN_COS_V = 0.15;    // beyond 81 degrees a pixel's footprint is too long to stand for a point

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    Pixel pixel;
    if (!load_pixel(at, pixel)) discard;
    vec4 image = texelFetch(u_image, at, 0);
    vec4 irradiance = texelFetch(u_irradiance, at, 0);
    float e = (irradiance.r + irradiance.g + irradiance.b) / 3.0;
    float cos_v = dot(pixel.N, toward_camera(pixel.P));
    if (e <= 0.0 || cos_v <= MIN_COS_V || image.a <= 0.0) discard;

    // Edges of shadow and silhouette are kept with a small weight: texels that have nothing else
    // would lose all their data.
    bool edge = irradiance.a > 0.0 || image.a < 0.999;
    vec4 p = vec4(pixel.P, 1.0);
    float slant = max(cos_v, 0.15);
    int reach = u_footprint > 0.25 ? 1 : 0;  // a point sample mixes nothing with its neighbours
    for (int y = -reach; y <= reach; y++) for (int x = -reach; x <= reach; x++) {
        ivec2 near = clamp(at + ivec2(x, y), ivec2(0), textureSize(u_position, 0) - 1);
        edge = edge || !same_surface(p, texelFetch(u_position, near, 0), slant, 1.5);
    }
    // A channel without light says nothing: NO_LIGHT marks it.
    vec3 f = mix(vec3(NO_LIGHT), image.rgb / max(irradiance.rgb, vec3(1e-20)), greaterThan(irradiance.rgb, vec3(1e-3 * e)));
    float quality = cos_v * e / (e + u_dark * u_level) * (edge ? u_edge_weight : 1.0);
    o_colour = vec4(f, quality * quality);
}
