// One lobe: a particle is a roughness; its Levenberg-Marquardt steps are scalar.
#include "include/random.glsl"
#include "solve/fit.glsl"
#define ROUGH float
#define ROUGH_OF(v) (v).x

const float CONVERGED = 2e-5;  // a step so short is the last: errors left are of its square

struct Particle {
    float r;
    float residual;
    float gradient, curvature;
    float damping;
};

float residual_at(float r) { return evaluate(r).x; }

const float UNTRIED = 1e30;  // residual of a particle that was not evaluated yet

Particle untried(float r) { return Particle(r, UNTRIED, 0.0, 1.0, 5e-3); }

// Levenberg-Marquardt; the first step of an untried particle goes nowhere and evaluates it.
void refine(inout Particle p, int steps) {
    for (int i = 0; i < steps; i++) {
        float step = clamp(p.gradient / (p.curvature * (1.0 + p.damping) + 1e-20), -0.15, 0.15);
        float r = clamp(p.r + step, ROUGHNESS_MIN, 1.0);
        vec3 fit = evaluate(r);
        if (fit.x < p.residual) p = Particle(r, fit.x, fit.y, fit.z, max(p.damping * 0.2, 1e-6));
        else p.damping = min(p.damping * 8.0, 1e4);
        if (abs(step) < CONVERGED && i > 0) break;
    }
}

bool apart(float a, float b) { return abs(a - b) > 0.02 * b + 0.005; }

// Place of particle i of `count`, 0..1 in log roughness (lobes differ by the ratio of their widths): stratified.
float stratum(ivec2 texel, int i, int count, int seed) {
    return (float(i) + 1.25 + 0.5 * random3(texel, i, 0, seed).x) / float(count + 1);
}

float random_step(ivec2 texel, int i, int t, int seed) { return random3(texel, i, t, seed).x; }

float ordered(float r) { return r; }
