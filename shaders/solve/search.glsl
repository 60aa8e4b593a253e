// The search of a texel, all in one draw: a stratified swarm, moved by equations (2) and (3), whose particles
// then take Levenberg-Marquardt steps and race; the two best in different valleys run to the end.
// The methods `swarm`, `refined` and `draft` are this kernel with other knobs.
//
// Defines: LOBES; SWARM where particles move; ROBUST where outliers are not believed (one lobe); STARTED where the
// first particle begins at the last result, and others are fewer.
#include "include/random.glsl"
// Here, not in one branch below: a file is pasted only where it is first asked for.
#include "solve/observations.glsl"
#if LOBES == 2
#include "solve/particle_two.glsl"
#else
#include "solve/particle.glsl"
#endif
const float HOPELESS = 1e4;  // times the best's residual: a valley so much worse is not followed to its end

uniform int u_particles;
uniform int u_moves;       // of the swarm
uniform int u_race_steps;  // Levenberg-Marquardt steps of every particle
uniform int u_final_steps; // of the two best
uniform int u_seed;

#ifdef STARTED
uniform sampler2D u_start;  // roughness1, roughness2, weight, whether known
uniform int u_started;      // particles of a texel that it knows
int particles;              // of this texel
bool started;               // whether the first of them begins at the last result
#else
#define particles u_particles
const bool started = false;
#endif

ROUGH roughness_at(ROUGH x) { return ROUGHNESS_MIN * pow(ROUGH(1.0 / ROUGHNESS_MIN), x); }

#ifdef SWARM
// Equation (2) of Nagano, Collins, Chen and Nakano in the form that converges: constriction chi (Clerc and
// Kennedy 2002), velocity limit, walls that absorb; the global best is that of a ring of three (Kennedy and
// Mendes 2002), because one best for all converges before it has searched.
const int PARTICLES = 16;
const float CHI = 0.7298, C1 = 2.05, C2 = 2.05, VELOCITY_MAX = 0.3;
ROUGH placed(int i);
ROUGH x[PARTICLES], v[PARTICLES], personal[PARTICLES];
float fitness[PARTICLES];

void swarm() {
    ivec2 texel = texel_here();
    for (int i = 0; i < particles; i++) {
        x[i] = personal[i] = placed(i);
        v[i] = 0.2 * (random_step(texel, i, 1, u_seed) - 0.5);
        fitness[i] = residual_at(roughness_at(x[i]));
    }
    for (int t = 2; t < u_moves + 2; t++) {
        for (int i = 0; i < particles; i++) {
            int left = (i + particles - 1) % particles, right = (i + 1) % particles;
            int leader = fitness[left] < fitness[i] ? left : i;
            if (fitness[right] < fitness[leader]) leader = right;
            ROUGH u1 = random_step(texel, i, 2 * t, u_seed), u2 = random_step(texel, i, 2 * t + 1, u_seed);
            v[i] = CHI * (v[i] + C1 * u1 * (personal[i] - x[i]) + C2 * u2 * (personal[leader] - x[i]));  // eq. 2
            v[i] = clamp(v[i], -VELOCITY_MAX, VELOCITY_MAX);
            ROUGH moved = x[i] + v[i];                                                                   // eq. 3
            x[i] = clamp(moved, 0.0, 1.0);
            v[i] *= 1.0 - abs(sign(x[i] - moved));  // a wall takes the velocity
            x[i] = ordered(x[i]);
            float fit = residual_at(roughness_at(x[i]));
            if (fit < fitness[i]) {
                fitness[i] = fit;
                personal[i] = x[i];
            }
        }
    }
}
#endif

// Where particle i begins, 0..1 as stratum().
ROUGH placed(int i) {
    int first = started ? 1 : 0;
#ifdef STARTED
    if (i < first) {
        ROUGH last = ROUGH_OF(texelFetch(u_start, texel_here(), 0));
        return clamp(1.0 - log(last) / log(ROUGHNESS_MIN), ROUGH(0.0), ROUGH(1.0));
    }
#endif
    return stratum(texel_here(), i - first, particles - first, u_seed);
}

// Where particle i's race starts.
ROUGH start(int i) {
#ifdef SWARM
    return roughness_at(personal[i]);
#else
    return roughness_at(placed(i));
#endif
}

void kernel() {
    out_0 = vec4(0.5, 0.0, 0.5, 0.0);
    out_1 = vec4(0.0);
    out_2 = vec4(0.0);
#if LOBES == 2
    out_0 = vec4(0.3, 0.6, 0.5, 0.0);
#endif
    if (!load_observations()) return;
#ifdef STARTED
    started = texelFetch(u_start, texel_here(), 0).w > 0.5;
    particles = started ? u_started : u_particles;
#endif
#ifdef ROBUST
    obs_variance = u_noise_share * noise_around(u_noise, texel_here(), textureSize(u_texel_position, 0));
#endif
#ifdef SWARM
    swarm();
#endif
    Particle best, second;
    best.residual = second.residual = UNTRIED;
    best.r = second.r = ROUGH(0.5);
    // All particles' races and the two finals are rounds of one loop: compilers inline all calls, and the model is
    // by far the longest.
    for (int round = 0; round < particles + 2; round++) {
        bool race = round < particles;
        Particle p = best;
        if (race) p = untried(start(min(round, particles - 1)));
        else if (round > particles) p = second;
        bool hopeful = p.residual < min(UNTRIED, HOPELESS * best.residual);
        refine(p, race ? u_race_steps + 1 : (hopeful ? u_final_steps : 0));
        if (round == particles) best = p;
        else if (round > particles) second = p;
        else {
            bool other = apart(p.r, best.r);
            if (p.residual < best.residual) {
                if (other) second = best;
                best = p;
            } else if (other && p.residual < second.residual) {
                second = p;
            }
        }
    }
    if (second.residual >= UNTRIED) second = best;
    if (second.residual < best.residual) {
        Particle swap = best;
        best = second;
        second = swap;
    }
#if LOBES == 2
    out_0 = vec4(best.r, best.weight, best.residual);  // best pair, its weight and residual
    out_1 = vec4(obs_share, obs_total, obs_free, 1.0);
    out_2 = vec4(best.curvature, 0.0);
#else
    evaluate(best.r);
#ifdef ROBUST
    second.residual -= best.residual - fit_squares;  // what outliers cost says nothing of the noise
    best.residual = fit_squares;
    obs_total -= fit_outliers;
    obs_free = max(obs_free - fit_outliers, 0.25);
#endif
    out_0 = vec4(best.r, best.residual, second.r, second.residual);  // the two valleys
    out_1 = vec4(best.curvature, obs_total, obs_free, 1.0);  // good observations, degrees of freedom, observed
    out_2 = vec4(evaluate_lambert(), fit_albedo(), obs_share);  // residual without lobe; what fit_albedo() says
#endif
}
