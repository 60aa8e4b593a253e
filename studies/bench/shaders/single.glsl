// Rival: Levenberg-Marquardt from one start in the middle, on the product's own residual.
#include "include/random.glsl"
#include "solve/observations.glsl"
#if LOBES == 2
#include "solve/particle_two.glsl"
const vec2 START = vec2(0.25, 0.5);
#else
#include "solve/particle.glsl"
const float START = 0.35;
#endif
uniform int u_steps;

void kernel() {
    out_0 = vec4(0.5);
    if (!load_observations()) return;
    Particle p = untried(START);
    refine(p, u_steps + 1);  // the first only evaluates
#if LOBES == 2
    out_0 = vec4(p.r, p.weight, p.residual);
#else
    out_0 = vec4(p.r, p.residual, 0.0, 0.0);
#endif
}
