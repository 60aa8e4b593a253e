// A view's pixel as an observation, where the view has several lights: radiance per irradiance, and how far to trust it.
#include "include/observed.glsl"
uniform sampler2D u_image;       // radiance, quality (0: clipped, or black; 1: good; between: partly covered)
uniform sampler2D u_irradiance;  // of the view's lights; a: what soft shadows of an environment leave in doubt
uniform sampler2D u_edges;       // light that edges of lamps' shadows leave in doubt

// How much light soft shadows let through is known roughly: where what they leave in doubt is this share of all light, an
// observation counts half.
const float DOUBT_SHARE = 0.4;

#ifdef BOUNCED
uniform sampler2D u_bounced;     // indirect irradiance; a: the sum of what is light from all around
uniform sampler2D u_glossy;      // what highlights of it add to the picture

// Indirect light is known to some per cent only: where it is this share of all light, an observation counts half.
const float BOUNCED_SHARE = 0.2;
// Light from all around is taken to be alike from everywhere, so that it is known to about half.  That error is alike in
// neighbours and does not average out: relative to what is typical, an observation has half its weight at this share.
const float AMBIENT_SHARE = 0.005;
const float TYPICAL = 10.0;  // irradiance over the level, which is radiance: of a surface of albedo 0.3
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
    vec4 bounced = texelFetch(u_bounced, at, 0);
    vec4 image = texelFetch(u_image, at, 0);
    // What is known to some per cent makes nothing negative that was not.
    image.rgb = max(image.rgb - texelFetch(u_glossy, at, 0).rgb, min(image.rgb, 0.0));
    all += bounced.rgb;
    float light = max(dot(all, vec3(1.0)), 1e-20);
    float share = dot(bounced.rgb, vec3(1.0)) / light / BOUNCED_SHARE;
    float ambient = bounced.a / light / AMBIENT_SHARE, typical = bounced.a / (3.0 * TYPICAL * u_level) / AMBIENT_SHARE;
    o_colour = observation(image, all, cos_v, edge);
    o_colour.a *= min((1.0 + typical * typical) / (1.0 + ambient * ambient), 1.0) / (1.0 + share * share);
#else
    o_colour = observation(texelFetch(u_image, at, 0), all, cos_v, edge);
#endif
    float doubt = edge ? 0.0 : 3.0 * irradiance.a / max(dot(all, vec3(1.0)), 1e-20) / DOUBT_SHARE;
    o_colour.a /= 1.0 + doubt * doubt;
    o_colour = with_bound(o_colour, cos_v);
}
