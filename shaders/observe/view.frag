// A view with one light, whole: what its pixels observe, and the light's lobe there.
#include "include/observed.glsl"
uniform sampler2D u_image;  // radiance, quality (0: clipped, or black; 1: good; between: partly covered)
uniform vec3 u_power;
#ifdef BOUNCED
#include "observe/beside_bounced.glsl"
#endif

layout(location = 0) out vec4 o_colour;  // radiance / irradiance (1/sr), quality (about 1: good)
layout(location = 1) out vec4 o_lobe;    // sin2h, radius2, cos_l, F / (2 cos_l cos_v)

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    Pixel pixel;
    if (!load_pixel(at, pixel)) discard;
    float e, cos_v = dot(pixel.N, toward_camera(pixel.P));
    o_lobe = lobe_geometry(pixel, e);
    float lit = texelFetch(u_lit, at, 0).r;
    int rim = int(texelFetch(u_rim, at, 0).r);
    vec4 image = texelFetch(u_image, at, 0);
#ifdef BOUNCED
    bool edge = (e > 0.0 && in_doubt(at, pixel, rim) > 0.0) || rim >= SILHOUETTE;
    vec3 light = u_power * max(e, 0.0) * lit;
    vec4 bounced = texelFetch(u_bounced, at, 0);
    o_lobe.w *= dot(light / max(light + bounced.rgb, vec3(1e-20)), vec3(1.0)) / 3.0;
    o_colour = with_bound(beside_bounced(image, light, bounced, texelFetch(u_glossy, at, 0).rgb, cos_v, edge), cos_v);
#else
    e *= lit;
    if (e <= 0.0) o_lobe.w = 0.0;
    bool edge = (e > 0.0 && in_doubt(at, pixel, rim) > 0.0) || rim >= SILHOUETTE;
    o_colour = with_bound(observation(image, u_power * e, cos_v, edge), cos_v);
#endif
}
