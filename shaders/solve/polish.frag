// The last word on a texel: Levenberg-Marquardt from every valley found, under the neighbours' prior.
#include "solve/fit.glsl"
#include "solve/nodes.glsl"
uniform sampler2D u_valleys;   // whole maps
uniform sampler2D u_support;
uniform sampler2D u_estimate;  // from the pyramid's finest level
uniform sampler2D u_prior;
uniform sampler2D u_noise;
uniform float u_prior_cut;
uniform int u_steps;

layout(location = 0) out vec4 o_roughness;  // roughness, standard error, residual (relative RMS), solved
layout(location = 1) out vec4 o_detail;     // good observations, residual, residual of the model without lobe, confidence

float mean, information;  // of the prior
float least, degrees, around, trust;

// Cost, minus its slope, curvature of data and prior together.
vec3 posterior(float r) {
    vec3 fit = evaluate(r);
    float down = 2.0 * trust * data_slope(fit.x, degrees, around);
    float off = r - mean;
    float prior = 0.5 * off * off * information;
    bool inside = prior < u_prior_cut;
    return vec3(trust * data_cost(fit.x, least, degrees, around) + min(prior, u_prior_cut),
                down * fit.y - (inside ? off * information : 0.0), down * fit.z + (inside ? information : 0.0));
}

void main() {
    o_roughness = o_detail = vec4(0.0);
    if (!load_observations()) return;
    ivec2 texel = texel_here();
    vec4 valleys = texelFetch(u_valleys, texel, 0), support = texelFetch(u_support, texel, 0);
    vec4 prior = texelFetch(u_prior, texel, 0);
    around = noise_around(u_noise, texel, textureSize(u_valleys, 0));
    least = valleys.y;
    degrees = support.z;
    trust = belief(support.y, obs_share);
    mean = prior.x;
    information = 1.0 / prior.y;
    float best_r = 0.5;
    vec3 best = vec3(1e30, 0.0, 1e-6);
    for (int start = 0; start < 3; start++) {
        float r = start == 0 ? texelFetch(u_estimate, texel, 0).x : (start == 1 ? valleys.x : valleys.z);
        vec3 here = posterior(r);
        float damping = 1e-3;
        for (int i = 0; i < u_steps; i++) {
            float to = clamp(r + clamp(here.y / (here.z * (1.0 + damping) + 1e-12), -0.15, 0.15), ROUGHNESS_MIN, 1.0);
            vec3 there = posterior(to);
            if (there.x < here.x) {
                r = to;
                here = there;
                damping = max(damping * 0.2, 1e-6);
            } else {
                damping = min(damping * 8.0, 1e4);
            }
        }
        if (here.x < best.x) {
            best = here;
            best_r = r;
        }
    }
    vec3 fit = evaluate(best_r);
    float error = inversesqrt(max(best.z, 1e-6));
    o_roughness = vec4(best_r, error, sqrt(fit.x / max(support.y, 0.25)), 1.0);
    // Half where the standard error of roughness is 0.05; few observations count for less.
    o_detail = vec4(support.y, fit.x, evaluate_lambert(), belief(support.y, 1.0) / (1.0 + error * error / (0.05 * 0.05)));
}
