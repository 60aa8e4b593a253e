// A view's pixel as an observation, where indirect light is added to that of its lamps.
uniform sampler2D u_bounced;     // indirect irradiance; a: the sum of what is light from all around
uniform sampler2D u_glossy;      // what highlights of it add to the picture

// Indirect light is known to some per cent only: where it is this share of all light, an observation counts half.
const float BOUNCED_SHARE = 0.2;
// Light from all around is taken to be alike from everywhere, so that it is known to about half.  That error is alike in
// neighbours and does not average out: relative to what is typical, an observation has half its weight at this share.
const float AMBIENT_SHARE = 0.005;
const float TYPICAL = 10.0;  // irradiance over the level, which is radiance: of a surface of albedo 0.3

// As `observation`.  ``lamps``: their irradiance; ``bounced``, ``glossy``: of the pixel, from the textures.
vec4 beside_bounced(vec4 image, vec3 lamps, vec4 bounced, vec3 glossy, float cos_v, bool edge) {
    // What is known to some per cent makes nothing negative that was not.
    image.rgb = max(image.rgb - glossy, min(image.rgb, 0.0));
    vec3 all = lamps + bounced.rgb;
    float light = max(dot(all, vec3(1.0)), 1e-20);
    float share = dot(bounced.rgb, vec3(1.0)) / light / BOUNCED_SHARE;
    float ambient = bounced.a / light / AMBIENT_SHARE, typical = bounced.a / (3.0 * TYPICAL * u_level) / AMBIENT_SHARE;
    vec4 observed = observation(image, all, cos_v, edge);
    observed.a *= min((1.0 + typical * typical) / (1.0 + ambient * ambient), 1.0) / (1.0 + share * share);
    return observed;
}
