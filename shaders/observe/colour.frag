// A view's pixel as an observation, where the view has several lights: radiance per irradiance, and how far to trust it.
#include "include/observed.glsl"
uniform sampler2D u_image;       // radiance, quality (0: unusable, 1: good, between: partly covered)
uniform sampler2D u_irradiance;  // of the view's lights; a = shadow edge
#ifdef BOUNCED
uniform sampler2D u_bounced;     // indirect irradiance
uniform sampler2D u_glossy;      // what highlights of it add to the picture

// Indirect light is known to some per cent only: where it is this share of all light, an observation counts half.
const float BOUNCED_SHARE = 0.2;
#endif

layout(location = 0) out vec4 o_colour;  // radiance / irradiance (1/sr), quality (about 1: good)

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    Pixel pixel;
    if (!load_pixel(at, pixel)) discard;
    float cos_v = dot(pixel.N, toward_camera(pixel.P));
    vec4 irradiance = texelFetch(u_irradiance, at, 0);
    bool silhouette = int(texelFetch(u_rim, at, 0).r) >= SILHOUETTE;
    bool edge = irradiance.a > 0.0 || silhouette;
#ifdef BOUNCED
    vec3 bounced = texelFetch(u_bounced, at, 0).rgb;
    vec4 image = texelFetch(u_image, at, 0);
    // What is known to some per cent makes nothing negative that was not.
    image.rgb = max(image.rgb - texelFetch(u_glossy, at, 0).rgb, min(image.rgb, 0.0));
    float share = dot(bounced, vec3(1.0)) / max(dot(bounced + irradiance.rgb, vec3(1.0)), 1e-20) / BOUNCED_SHARE;
    o_colour = observation(image, irradiance.rgb + bounced, cos_v, edge);
    o_colour.a /= 1.0 + share * share;
#else
    o_colour = observation(texelFetch(u_image, at, 0), irradiance.rgb, cos_v, edge);
#endif
}
