// Two lobes: a particle is a pair of roughnesses, r1 <= r2, with the weight that its last step found.
#include "include/random.glsl"
#include "solve/fit_two.glsl"
#define ROUGH vec2
#define ROUGH_OF(v) (v).xy

const vec2 SHARP = vec2(0.33, 0.7);   // roughness 0.13 to 0.41
const vec2 RATIO = vec2(0.12, 0.48);  // 1.4 to 4.2
const float CONVERGED = 2e-6;  // a step so short is the last

struct Particle {
    vec2 r;
    float weight;
    float residual;
    vec2 gradient;
    vec3 curvature;
    float damping;
};

float residual_at(vec2 r) { return evaluate(r, 0.5).residual; }

Particle particle(vec2 r, float weight, float damping) {
    FitTwo fit = evaluate(r, weight);
    return Particle(r, fit.weight, fit.residual, fit.gradient, fit.curvature, damping);
}

const float UNTRIED = 1e30;  // residual of a particle that was not evaluated yet

Particle untried(vec2 r) { return Particle(r, 0.5, UNTRIED, vec2(0.0), vec3(1.0, 0.0, 1.0), 5e-3); }

vec2 solve_2x2(vec3 m, vec2 b) {
    float determinant = max(m.x * m.z - m.y * m.y, 1e-20 + 1e-7 * m.x * m.z);
    return vec2(m.z * b.x - m.y * b.y, m.x * b.y - m.y * b.x) / determinant;
}

// Levenberg-Marquardt; the first step of an untried particle goes nowhere and evaluates it.
void refine(inout Particle p, int steps) {
    for (int i = 0; i < steps; i++) {
        vec3 damped = p.curvature + vec3(p.damping, 0.0, p.damping) * p.curvature + vec3(1e-12, 0.0, 1e-12);
        vec2 step = clamp(solve_2x2(damped, p.gradient), -0.15, 0.15);
        vec2 r = clamp(p.r + step, ROUGHNESS_MIN, 1.0);
        float weight = p.weight;
        if (r.x > r.y) {
            r = r.yx;
            weight = 1.0 - weight;
        }
        Particle moved = particle(r, weight, max(p.damping * 0.2, 1e-6));
        if (moved.residual < p.residual) p = moved;
        else p.damping = min(p.damping * 8.0, 1e4);
        if (max(abs(step.x), abs(step.y)) < CONVERGED && i > 0) break;
    }
}

bool apart(vec2 a, vec2 b) { return any(greaterThan(abs(a - b), 0.02 * b + 0.005)); }

// Place of particle i, 0..1 in log roughness: a Kronecker sequence (Roberts 2018) with jitter, over the sharper
// lobe and the ratio of the two: lobes much sharper or nearly alike are rare, and reached from their neighbours.
vec2 stratum(ivec2 texel, int i, int count, int seed) {
    vec2 at = fract(0.5 + float(i + 1) * vec2(0.7548776662, 0.5698402910) + 0.25 / sqrt(float(count)) * random3(texel, i, 0, seed).xy);
    float sharp = mix(SHARP.x, SHARP.y, at.x);
    return vec2(sharp, min(sharp + mix(RATIO.x, RATIO.y, at.y), 1.0));
}

vec2 random_step(ivec2 texel, int i, int t, int seed) { return random3(texel, i, t, seed).xz; }

vec2 ordered(vec2 r) { return r.x <= r.y ? r : r.yx; }
