// The last word on a texel: Levenberg-Marquardt from every valley found, under the neighbours' prior.
#include "solve/fit.glsl"
#include "solve/nodes.glsl"
uniform sampler2D u_valleys;  // whole maps
uniform sampler2D u_support;
uniform sampler2D u_estimate;  // from the pyramid's finest level
uniform sampler2D u_prior;
uniform float u_prior_cut;
uniform int u_steps;
// out_0: roughness, its standard error, how many numbers the data themselves determined, solved
// out_1: good observations, residual, residual of the model without lobe, standard error of base colour

float mean, information;  // of the prior
float least, price, degrees, around, trust;

vec3 fit;          // of the data alone, where posterior() was asked last
vec3 best_fit;     // where descend() ended
vec2 end_albedo;   // fit_albedo() there

// Cost, minus its slope, curvature of data and prior together.
vec3 posterior(float r) {
    fit = evaluate(r);
    fit.x = max(fit.x - price, 0.0);
    float down = 2.0 * trust * data_slope(fit.x, degrees, around);
    float off = r - mean;
    float prior = 0.5 * off * off * information;
    bool inside = prior < u_prior_cut;
    return vec3(trust * data_cost(fit.x, least, degrees, around) + min(prior, u_prior_cut),
                down * fit.y - (inside ? off * information : 0.0), down * fit.z + (inside ? information : 0.0));
}

// Damped Gauss-Newton from r: where it ends, and what the posterior is there.
float descend(float r, int steps, out vec3 here) {
    float damping = 1e-3, to = r;
    here = vec3(1e30, 0.0, 1.0);
    for (int i = 0; i <= steps; i++) {  // the first goes nowhere
        vec3 there = posterior(to);
        if (there.x < here.x) {
            r = to;
            here = there;
            best_fit = fit;
            end_albedo = fit_albedo();
            damping = max(damping * 0.2, 1e-6);
        } else {
            damping = min(damping * 8.0, 1e4);
        }
        to = clamp(r + clamp(here.y / (here.z * (1.0 + damping) + 1e-12), -0.15, 0.15), ROUGHNESS_MIN, 1.0);
    }
    return r;
}

void kernel() {
    out_0 = out_1 = vec4(0.0);
    if (!load_observations()) return;
    ivec2 texel = texel_here();
    vec4 valleys = texelFetch(u_valleys, texel, 0), support = texelFetch(u_support, texel, 0);
    around = noise_around(u_noise, texel, textureSize(u_valleys, 0));
    least = valleys.y;
    degrees = support.z;
    trust = belief(support.y, obs_share);
    price = 0.0;
#ifdef ROBUST
    obs_variance = around;
    price = evaluate(valleys.x).x - fit_squares;
#endif
    vec3 best = vec3(1e30, 0.0, 1.0), final_fit = best;
    vec2 best_albedo = vec2(0.0);
    vec4 prior = texelFetch(u_prior, texel, 0);
    mean = prior.x;
    information = 1.0 / prior.y;
    vec3 starts = vec3(valleys.x, texelFetch(u_estimate, texel, 0).x, valleys.z);
    float r = 0.5;
    for (int i = 0; i < 3; i++) {
        vec3 there;
        float other = descend(starts[i], u_steps, there);
        if (there.x < best.x) {
            best = there;
            r = other;
            final_fit = best_fit;
            best_albedo = end_albedo;
        }
    }
    float variance = 1.0 / max(best.z, 1e-6);
    variance = variance < 0.01 * r * r ? variance + prior.z : max(prior.w, 0.25 * variance);
    // Effective parameters (Moody 1992): curvature of the data of that of data and prior.
    float determined = 2.0 * trust * data_slope(final_fit.x, degrees, around) * final_fit.z / max(best.z, 1e-12);
    out_0 = vec4(r, sqrt(min(variance, 0.25)), clamp(determined, 0.0, 1.0), 1.0);
    out_1 = vec4(support.y, final_fit.x, evaluate_lambert(), sqrt(best_albedo.x * best_albedo.x * variance + best_albedo.y * around));
}
