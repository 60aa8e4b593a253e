// One pass over the texels of a two-lobe solve: a texel takes the best of its own pair of roughnesses and its
// neighbours', scored on its own data under a prior from the neighbourhood, and refines it.
#include "solve/fit_two.glsl"
#include "solve/particle_two.glsl"
#include "solve/nodes.glsl"
uniform sampler2D u_pairs;     // roughness1, roughness2, weight, residual; whole maps
uniform sampler2D u_variance;  // of roughness1, roughness2 with their neighbours; of the worse by itself; observed
uniform float u_prior_cut;
uniform float u_tau;           // how much neighbours differ (standard deviation); 0: no prior
uniform int u_stride;          // to the neighbours whose pairs are tried
uniform int u_steps;
// out_0: as u_pairs.  out_1: as u_variance.  out_2: good observations, residual, how many numbers the data themselves
// determined, standard error of base colour

const int WINDOW = 2;      // 5 x 5
const float WIDE = 4.0;    // information of a prior as wide as roughness itself

float degrees, around, trust, least;
vec2 mean, information;  // of the prior

void neighbourhood(ivec2 texel) {
    vec2 sum = vec2(0.0), total = vec2(0.0);
    int reach = u_tau > 0.0 ? WINDOW : -1;
    for (int y = -reach; y <= reach; y++) for (int x = -reach; x <= reach; x++) {
        ivec2 at = texel + ivec2(x, y);
        if ((x == 0 && y == 0) || any(lessThan(at, ivec2(0))) || any(greaterThanEqual(at, textureSize(u_pairs, 0)))) continue;
        vec4 variance = texelFetch(u_variance, at, 0);
        vec2 w = variance.w / (variance.xy + u_tau * u_tau);
        sum += w * texelFetch(u_pairs, at, 0).xy;
        total += w;
    }
    mean = sum / max(total, vec2(1e-20));
    information = u_tau > 0.0 ? 1.0 / (1.0 / max(total, vec2(1e-6)) + u_tau * u_tau) : vec2(0.0);
}

float cost(Particle p) {
    vec2 off = p.r - mean;
    return trust * data_cost(p.residual, least, degrees, around) + min(0.5 * dot(off * off, information), u_prior_cut);
}

// Damped Gauss-Newton steps on data and prior together.
void settle(inout Particle p) {
    float here = cost(p);
    for (int i = 0; i < u_steps; i++) {
        float down = 2.0 * trust * data_slope(p.residual, degrees, around);
        vec2 off = p.r - mean;
        vec2 pull = 0.5 * dot(off * off, information) < u_prior_cut ? information : vec2(0.0);
        vec3 bend = down * p.curvature + vec3(pull.x, 0.0, pull.y);
        bend += p.damping * vec3(bend.x, 0.0, bend.z) + vec3(1e-9, 0.0, 1e-9);
        vec2 r = clamp(p.r + clamp(solve_2x2(bend, down * p.gradient - off * pull), -0.15, 0.15), ROUGHNESS_MIN, 1.0);
        Particle moved = particle(ordered(r), r.x > r.y ? 1.0 - p.weight : p.weight, max(p.damping * 0.2, 1e-6));
        float there = cost(moved);
        if (there < here) {
            p = moved;
            here = there;
        } else {
            p.damping = min(p.damping * 8.0, 1e4);
        }
    }
}

void kernel() {
    out_0 = vec4(0.3, 0.6, 0.5, 0.0);
    out_1 = out_2 = vec4(0.0);
    if (!load_observations()) return;
    ivec2 texel = texel_here();
    degrees = obs_free;
    trust = belief(obs_total, obs_share);
    around = noise_around(u_noise, texel, textureSize(u_pairs, 0));
    vec4 own = texelFetch(u_pairs, texel, 0);
    least = own.w;
    neighbourhood(texel);
    Particle best;
    float best_cost = 1e30;
    for (int j = 0; j < 9; j++) {
        int k = (j + 4) % 9;  // its own first
        ivec2 at = texel + u_stride * ivec2(k % 3 - 1, k / 3 - 1);
        if (any(lessThan(at, ivec2(0))) || any(greaterThanEqual(at, textureSize(u_pairs, 0)))) continue;
        if (j > 0 && texelFetch(u_variance, at, 0).w < 0.5) continue;
        vec4 theirs = texelFetch(u_pairs, at, 0);
        Particle other = particle(theirs.xy, theirs.z, 1e-3);
        float other_cost = cost(other);
        if (other_cost < best_cost) {
            best = other;
            best_cost = other_cost;
        }
    }
    settle(best);
    float down = 2.0 * trust * data_slope(best.residual, degrees, around);
    vec3 data = down * best.curvature, bend = data + vec3(information.x + WIDE, 0.0, information.y + WIDE);
    float determinant = max(bend.x * bend.z - bend.y * bend.y, 1e-6 * bend.x * bend.z);
    // Effective parameters (Moody 1992): trace of data (data + prior)^-1, and the weight.
    float determined = (data.x * bend.z + data.z * bend.x - 2.0 * data.y * bend.y) / determinant;
    determined = clamp(determined, 0.0, 2.0) + (best.weight > 0.0 && best.weight < 1.0 ? 1.0 : 0.0);
    out_0 = vec4(best.r, best.weight, best.residual);
    // The standard error is that of the texel's own data: neighbours err together with it (two lobes are often told
    // apart by none of them), so their agreement proves little.
    vec3 alone = data + vec3(WIDE, 0.0, WIDE);
    float worse = max(alone.x, alone.z) / max(alone.x * alone.z - alone.y * alone.y, 1e-6 * alone.x * alone.z);
    out_1 = vec4(bend.z / determinant, bend.x / determinant, worse, 1.0);
    // The weight follows the roughnesses, and has an error of its own.
    FitTwo last = evaluate(best.r, best.weight);
    float weights = max(last.weight_row.x, 1e-12);
    vec2 slope = fit_albedo.zw - fit_albedo.y * last.weight_row.yz / weights;
    float spread = (slope.x * slope.x * bend.z - 2.0 * slope.x * slope.y * bend.y + slope.y * slope.y * bend.x) / determinant;
    float of_weight = fit_albedo.y * fit_albedo.y / (down * weights + WIDE);
    out_2 = vec4(obs_total, best.residual, determined, sqrt(fit_albedo.x * around + spread + of_weight));
}
