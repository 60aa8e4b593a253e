// Irradiance of one light on every pixel, added to that of the view's other lights.
#include "include/observed.glsl"
uniform vec3 u_power;

layout(location = 0) out vec4 o_irradiance;  // RGB, W/m^2
layout(location = 1) out vec4 o_edge;        // of their mean what a shadow's edge or the terminator leaves in doubt

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    Pixel pixel;
    if (!load_pixel(at, pixel)) discard;
    float e = irradiance_of(pixel);
    vec3 light = u_power * max(e, 0.0);
    o_irradiance = vec4(light * texelFetch(u_lit, at, 0).r, 0.0);
    o_edge = vec4(dot(light, vec3(1.0 / 3.0)) * in_doubt(at, pixel, int(texelFetch(u_rim, at, 0).r)));
}
