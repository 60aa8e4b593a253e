// Rival: Adam (Kingma and Ba 2015) on the roughness, or on both, with base colour and weight eliminated as in the
// product: the gradient is that of the projected residual, relative to its size.
#include "include/random.glsl"
#include "solve/observations.glsl"
#if LOBES == 2
#include "solve/particle_two.glsl"
const vec2 START = vec2(0.3, 0.6);
#else
#include "solve/particle.glsl"
const float START = 0.5;
#endif
uniform int u_steps;
uniform float u_rate;

void kernel() {
    out_0 = vec4(0.5);
    if (!load_observations()) return;
    ROUGH r = START, first = ROUGH(0.0), second = ROUGH(0.0);
    float weight = 0.5, fade1 = 1.0, fade2 = 1.0;
    for (int i = 0; i < u_steps; i++) {
#if LOBES == 2
        FitTwo fit = evaluate(r, weight);
        weight = fit.weight;
        ROUGH slope = -2.0 * fit.gradient;
#else
        ROUGH slope = -2.0 * evaluate(r).y;
#endif
        fade1 *= 0.9;
        fade2 *= 0.999;
        first = mix(slope, first, 0.9);
        second = mix(slope * slope, second, 0.999);
        r -= u_rate * first / (1.0 - fade1) / (sqrt(second / (1.0 - fade2)) + 1e-8);
        r = clamp(r, ROUGHNESS_MIN, 1.0);
    }
#if LOBES == 2
    out_0 = vec4(r, weight, 0.0);
#else
    out_0 = vec4(r, 0.0, 0.0, 0.0);
#endif
}
