// Light from all around, alike from everywhere, as indirect light: its irradiance, and what highlights of it add.
#include "include/brdf.glsl"
#include "include/pixel.glsl"
uniform sampler2D u_open;     // irradiance at radiance 1: of what no surface hides
uniform vec3 u_radiance;      // W/(m^2 sr)
#ifdef BOUNCED
uniform sampler2D u_bounced;  // irradiance of other indirect light
uniform sampler2D u_glossy;   // what highlights of that add
#endif

// The albedo of the specular lobe under light from everywhere; it depends little on roughness.
const float GLOSS = 0.5;

layout(location = 0) out vec4 o_irradiance;  // a: the sum of what is light from all around
layout(location = 1) out vec4 o_glossy;

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    Pixel pixel;
    if (!load_pixel(at, pixel)) discard;
    vec3 light = u_radiance * texelFetch(u_open, at, 0).g;
    float albedo = principled_energy(GLOSS, max(dot(pixel.N, toward_camera(pixel.P)), 0.0)).y;
    o_irradiance = vec4(light, dot(light, vec3(1.0)));
    o_glossy = vec4(light * (albedo / PI), 1.0);
#ifdef BOUNCED
    o_irradiance.rgb += texelFetch(u_bounced, at, 0).rgb;
    o_glossy.rgb += texelFetch(u_glossy, at, 0).rgb;
#endif
}
