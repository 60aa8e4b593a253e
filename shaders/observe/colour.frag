// A view's pixel as an observation, where the view has several lights: radiance per irradiance, and how far to trust it.
#include "include/observed.glsl"
uniform sampler2D u_image;       // radiance, quality (0: unusable, 1: good, between: partly covered)
uniform sampler2D u_irradiance;  // of the view's lights; a = shadow edge

layout(location = 0) out vec4 o_colour;  // radiance / irradiance (1/sr), quality (about 1: good)

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    Pixel pixel;
    if (!load_pixel(at, pixel)) discard;
    float cos_v = dot(pixel.N, toward_camera(pixel.P));
    vec4 irradiance = texelFetch(u_irradiance, at, 0);
    bool silhouette = int(texelFetch(u_rim, at, 0).r) >= SILHOUETTE;
    o_colour = observation(texelFetch(u_image, at, 0), irradiance.rgb, cos_v, irradiance.a > 0.0 || silhouette);
}
