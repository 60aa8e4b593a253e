// A view's pixel as an observation, where the view has several lights: radiance per irradiance, and how far to trust it.
#include "include/observed.glsl"
uniform sampler2D u_image;       // radiance, quality (0: clipped, or black; 1: good; between: partly covered)
uniform sampler2D u_irradiance;  // of the view's lights; a: what soft shadows of an environment leave in doubt
uniform sampler2D u_edges;       // light that edges of lamps' shadows leave in doubt

// How much light soft shadows let through is known roughly: where what they leave in doubt is this share of all light, an
// observation counts half.
const float DOUBT_SHARE = 0.4;

#ifdef BOUNCED
#include "observe/beside_bounced.glsl"
#endif

layout(location = 0) out vec4 o_colour;  // radiance / irradiance (1/sr), quality (about 1: good)

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    Pixel pixel;
    if (!load_pixel(at, pixel)) discard;
    float cos_v = dot(pixel.N, toward_camera(pixel.P));
    vec4 irradiance = texelFetch(u_irradiance, at, 0);
    bool silhouette = int(texelFetch(u_rim, at, 0).r) >= SILHOUETTE;
    vec3 all = irradiance.rgb;
    // The edge of a lamp that adds little to the others' light is none.
    bool edge = texelFetch(u_edges, at, 0).r > EDGE_SHARE * dot(all, vec3(1.0 / 3.0)) || silhouette;
#ifdef BOUNCED
    o_colour = beside_bounced(texelFetch(u_image, at, 0), all, texelFetch(u_bounced, at, 0), texelFetch(u_glossy, at, 0).rgb, cos_v, edge);
    all += texelFetch(u_bounced, at, 0).rgb;
#else
    o_colour = observation(texelFetch(u_image, at, 0), all, cos_v, edge);
#endif
    float doubt = edge ? 0.0 : 3.0 * irradiance.a / max(dot(all, vec3(1.0)), 1e-20) / DOUBT_SHARE;
    o_colour.a /= 1.0 + doubt * doubt;
    o_colour = with_bound(o_colour, cos_v);
}
