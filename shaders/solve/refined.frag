// Method `refined`: a stratified swarm whose particles take Levenberg-Marquardt steps and race;
// the two best in different valleys run to the end.
#include "include/random.glsl"
#include "solve/fit.glsl"
#include "solve/refine.glsl"
uniform int u_particles;
uniform int u_race_steps;
uniform int u_final_steps;
uniform int u_seed;

layout(location = 0) out vec4 o_valleys;  // best roughness, its residual, second roughness, its residual
layout(location = 1) out vec4 o_support;  // curvature at the best, good observations, degrees of freedom, observed

void main() {
    o_valleys = vec4(0.5, 0.0, 0.5, 0.0);
    o_support = vec4(0.0);
    if (!load_observations()) return;
    Particle best, second;
    best.fit = second.fit = vec3(1e30, 0.0, 0.0);
    best.r = second.r = 0.5;
    for (int i = 0; i < u_particles; i++) {
        float jitter = random3(texel_here(), i, 0, u_seed).x;
        // Stratified in log roughness: lobes differ by the ratio of their widths.
        float r = ROUGHNESS_MIN * pow(1.0 / ROUGHNESS_MIN, (float(i) + 0.25 + 0.5 * jitter + 1.0) / float(u_particles + 1));
        Particle p = particle_at(r);
        refine(p, u_race_steps);
        bool apart = abs(p.r - best.r) > 0.02 * best.r + 0.005;
        if (p.fit.x < best.fit.x) {
            if (apart) second = best;
            best = p;
        } else if (apart && p.fit.x < second.fit.x) {
            second = p;
        }
    }
    refine(best, u_final_steps);
    if (second.fit.x < 1e29) refine(second, u_final_steps);
    else second = best;
    if (second.fit.x < best.fit.x) {
        Particle swap = best;
        best = second;
        second = swap;
    }
    o_valleys = vec4(best.r, best.fit.x, second.r, second.fit.x);
    o_support = vec4(best.fit.z, obs_total, obs_free, 1.0);
}
