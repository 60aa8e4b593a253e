// What the specular lobe needs of one light at every pixel, where the view has several.
#include "include/observed.glsl"
uniform sampler2D u_irradiance;  // of all the view's lights
uniform vec3 u_power;
#ifdef BOUNCED
uniform sampler2D u_bounced;     // indirect irradiance
#endif
uniform vec3 u_channel;          // which channels' shares of the light count

layout(location = 0) out vec4 o_lobe;  // sin2h, radius2, cos_l, F / (2 cos_l cos_v) * E_light / E_view

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    Pixel pixel;
    if (!load_pixel(at, pixel)) discard;
    float e;
    vec4 lobe = lobe_geometry(pixel, e);
    vec3 own = u_power * e * texelFetch(u_lit, at, 0).r, all = texelFetch(u_irradiance, at, 0).rgb;
#ifdef BOUNCED
    // The lamps are of one colour, what has bounced is of another: the mean share is that of the channels' mean.
    float share = dot(own / max(all + texelFetch(u_bounced, at, 0).rgb, vec3(1e-20)), u_channel) / dot(u_channel, vec3(1.0));
#else
    float share = dot(own, u_channel) / max(dot(all, u_channel), 1e-20);
#endif
    o_lobe = vec4(lobe.xyz, lobe.w * share);
}
