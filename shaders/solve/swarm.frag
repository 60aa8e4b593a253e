// Method `swarm`: particle swarm per texel over roughness, albedo eliminated inside the fitness.
// Equations (2) and (3) of Nagano, Collins, Chen and Nakano in the form that converges: constriction
// chi (Clerc and Kennedy 2002), velocity limit, walls that absorb; the global best is that of a ring
// of three (Kennedy and Mendes 2002), because one best for all converges before it has searched.
#include "include/random.glsl"
#include "solve/fit.glsl"
uniform int u_iterations;
uniform int u_seed;

layout(location = 0) out vec4 o_valleys;
layout(location = 1) out vec4 o_support;

const int PARTICLES = 16;
const float CHI = 0.7298, C1 = 2.05, C2 = 2.05, VELOCITY_MAX = 0.3;

float roughness_at(float x) { return ROUGHNESS_MIN + (1.0 - ROUGHNESS_MIN) * x; }

void main() {
    o_valleys = vec4(0.5, 0.0, 0.5, 0.0);
    o_support = vec4(0.0);
    if (!load_observations()) return;
    float x[PARTICLES], v[PARTICLES], personal[PARTICLES], fitness[PARTICLES];
    for (int i = 0; i < PARTICLES; i++) {
        vec3 u = random3(texel_here(), i, 0, u_seed);
        x[i] = personal[i] = (float(i) + u.x) / float(PARTICLES);
        v[i] = (u.y - 0.5) * 0.2;
        fitness[i] = evaluate(roughness_at(x[i])).x;
    }
    for (int t = 1; t <= u_iterations; t++) {
        for (int i = 0; i < PARTICLES; i++) {
            int left = (i + PARTICLES - 1) % PARTICLES, right = (i + 1) % PARTICLES;
            int leader = fitness[left] < fitness[i] ? left : i;
            if (fitness[right] < fitness[leader]) leader = right;
            vec3 u = random3(texel_here(), i, t, u_seed);
            v[i] = CHI * (v[i] + C1 * u.x * (personal[i] - x[i]) + C2 * u.y * (personal[leader] - x[i]));  // eq. 2
            v[i] = clamp(v[i], -VELOCITY_MAX, VELOCITY_MAX);
            float moved = x[i] + v[i];                                                                    // eq. 3
            x[i] = clamp(moved, 0.0, 1.0);
            if (x[i] != moved) v[i] = 0.0;
            float fit = evaluate(roughness_at(x[i])).x;
            if (fit < fitness[i]) {
                fitness[i] = fit;
                personal[i] = x[i];
            }
        }
    }
    int best = 0;
    for (int i = 1; i < PARTICLES; i++) if (fitness[i] < fitness[best]) best = i;
    int second = best;
    float r = roughness_at(personal[best]);
    for (int i = 0; i < PARTICLES; i++) {
        bool apart = abs(roughness_at(personal[i]) - r) > 0.02 * r + 0.005;
        if (apart && (second == best || fitness[i] < fitness[second])) second = i;
    }
    o_valleys = vec4(r, fitness[best], roughness_at(personal[second]), fitness[second]);
    o_support = vec4(evaluate(r).z, obs_total, obs_free, 1.0);
}
