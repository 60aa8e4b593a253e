// A view with one light, whole: what its pixels observe, and the light's lobe there.
#include "include/observed.glsl"
uniform sampler2D u_image;  // radiance, quality (0: clipped, or black; 1: good; between: partly covered)
uniform vec3 u_power;

layout(location = 0) out vec4 o_colour;  // radiance / irradiance (1/sr), quality (about 1: good)
layout(location = 1) out vec4 o_lobe;    // sin2h, radius2, cos_l, F / (2 cos_l cos_v)

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    Pixel pixel;
    if (!load_pixel(at, pixel)) discard;
    float e, cos_v = dot(pixel.N, toward_camera(pixel.P));
    o_lobe = lobe_geometry(pixel, e);
    e *= texelFetch(u_lit, at, 0).r;
    if (e <= 0.0) o_lobe.w = 0.0;
    int rim = int(texelFetch(u_rim, at, 0).r);
    bool edge = (e > 0.0 && in_doubt(at, pixel, rim) > 0.0) || rim >= SILHOUETTE;
    o_colour = with_bound(observation(texelFetch(u_image, at, 0), u_power * e, cos_v, edge), cos_v);
}
