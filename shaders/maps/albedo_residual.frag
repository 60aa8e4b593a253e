// How far the texture, averaged over a pixel's footprint, is from the albedo that the pixel shows.
#include "include/pixel.glsl"
uniform sampler2D u_albedo;      // pixel grid: weighted sum
uniform sampler2D u_weight;      // as of maps/albedo_pixel.frag
uniform sampler2D u_uv;
uniform sampler2D u_uv_slope;
uniform sampler2D u_texture;     // texel grid, holes filled

uniform bool u_from_black;       // a step to what pixels show; the others sharpen it
uniform float u_beyond;          // what a pixel at a seam counts

const float BEND = 0.05;         // bend of the normal, see Pixel, at which a pixel counts half

layout(location = 0) out vec4 o_residual;  // RGB, weight

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec4 summed = texelFetch(u_weight, at, 0);
    vec3 weight = summed.rgb;
    o_residual = vec4(0.0);
    float most = summed.a;
    if (most <= 0.0) return;
    vec2 uv = texelFetch(u_uv, at, 0).xy;
    vec4 slope = texelFetch(u_uv_slope, at, 0);
    vec3 mean = vec3(0.0);
    for (int j = 0; j < (u_from_black ? 0 : 16); j++) {
        vec2 d = (vec2(float(j & 3), float(j >> 2)) - 1.5) * 0.25 * u_footprint;
        mean += textureLod(u_texture, uv + d.x * slope.xy + d.y * slope.zw, 0.0).rgb;
    }
    mean /= 16.0;
    vec3 shown = clamp(texelFetch(u_albedo, at, 0).rgb / max(weight, vec3(1e-12)), 0.0, 1.2);
    shown = mix(mean, shown, greaterThan(weight, vec3(0.0)));
    // Weights are relative squares: times the albedo squared they count good views.
    float grey = max(dot(shown, vec3(1.0 / 3.0)), 0.02);
    float views = most * grey * grey;
    // At a crease a pixel shows the mean of two sides, and its centre one of them: it sharpens little.
    Pixel pixel;
    bool bends = !u_from_black && load_pixel(at, pixel);
    float trust = bends ? 1.0 / (1.0 + pixel.bend2 / (BEND * BEND)) : 1.0;
    // It shows what lies beyond its island too, and looks up what the holes there are filled with.
    float own = at_seam(texelFetch(u_position, at, 0)) ? u_beyond : 1.0;
    o_residual = vec4(trust * (shown - mean), own * views / (views + 0.3));
}
