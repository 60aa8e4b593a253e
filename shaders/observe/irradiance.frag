// Irradiance of one light on every pixel, added to that of the view's other lights.
#include "include/observed.glsl"
uniform vec3 u_power;

layout(location = 0) out vec4 o_irradiance;  // RGB, W/m^2; EDGE where a shadow's edge passes

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    Pixel pixel;
    if (!load_pixel(at, pixel)) discard;
    float e = irradiance_of(pixel);
    bool shadow = shadow_edge(at, pixel, int(texelFetch(u_rim, at, 0).r));
    o_irradiance = vec4(u_power * e * texelFetch(u_lit, at, 0).r, e > 0.0 && shadow ? EDGE : 0.0);
}
