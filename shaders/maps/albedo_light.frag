// Unshadowed irradiance of one lamp at every pixel, over a typical one; lamps add up.
#include "include/lights.glsl"
uniform sampler2D u_position;  // pixel grid
uniform sampler2D u_normal;
uniform float u_power;         // W (SUN: W/m^2), mean of the channels, over the typical irradiance

layout(location = 0) out vec4 o_light;

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec4 p = texelFetch(u_position, at, 0);
    if (p.w < 0.5) discard;
    o_light = vec4(u_power * max(light_irradiance(p.xyz, texelFetch(u_normal, at, 0).xyz), 0.0));
}
