// Observations that fit nothing: shadows taken for light, lamps mirrored by something else.
//
// The noise is a contaminated normal (Tukey 1960): an observation is an outlier, of any size, with a likelihood of
// OUTLIER beside that of a perfect fit.  At each roughness the base colour is found by iteratively reweighted least
// squares (Holland and Welsch 1977) under a scale that falls from the residual's own to the noise's (graduated
// non-convexity, Blake and Zisserman 1987), so that outliers cannot capture it.
uniform float u_noise_share;  // of the variance there that is not outliers

const float OUTLIER = 0.0025;
const int CALMER = 4;  // steps of the falling scale

float obs_variance;  // of the noise, relative
vec2 group_said[GROUPS];  // weight and mean of each, under the trust that add_mean() has met

void prepare_group(int k, int first, int end, float r) {
#ifdef METALLIC
    prepare_metal(k, first, end, r);
    EACH_OF_GROUP(n) obs_trust[n] = 1.0;
#else
    group_toward[k] = toward(r, group_cos_v[k]);
    EACH_OF_GROUP(n) {
        float s;
        specular_d(n, r, group_toward[k], s, obs_slope[n]);
        obs_off[n] = obs_f[n] - s;
        obs_trust[n] = 1.0;
    }
#endif
}

// A group's weight and mean under the present trust.
vec2 group_mean(int k, int first, int end) {
    vec2 sum = vec2(1e-20, 0.0);
    EACH_OF_GROUP(n) sum += WEIGHT(n) * obs_trust[n] * vec2(1.0, obs_off[n]);
    return vec2(sum.x, sum.y / sum.x);
}

void add_mean(int k, int first, int end, inout CHANNEL weight, inout CHANNEL albedo) {
    vec2 g = group_mean(k, first, end);
    group_said[k] = g;
    float mean = g.y + OFFSET(k), a = DIFFUSE(k);
    float w = a * a * g.x / (1.0 + u_group_slack * g.x * mean * mean);
    weight += w * channel_of(k);
    albedo += w * mean / a * channel_of(k);
}

// (sum of squares, what outliers cost, how many there are) of one group about what its own mean and the albedo of all
// say together, in units of the noise; under the scale, trust is set anew.
vec3 trust_group(int k, int first, int end, float albedo, float scale) {
    vec2 g = group_said[k];
    float mean = g.y + OFFSET(k);
    float prior = 1.0 / max(u_group_slack * mean * mean, 1e-12);
    float centre = (g.x * mean + prior * albedo * DIFFUSE(k)) / (g.x + prior) - OFFSET(k);
    vec3 sums = vec3(0.0);
    EACH_OF_GROUP(n) {
        float off = obs_off[n] - centre;
        float square = WEIGHT(n) * off * off / obs_variance;
        sums.x += square;
        if (scale > 0.0) {  // else asked for the spread alone
            float likely = exp(-0.5 * square / scale);
            float trust = likely / (likely + OUTLIER);
            obs_trust[n] = trust;
            sums.y += -2.0 * log((likely + OUTLIER) / (1.0 + OUTLIER)) - trust * square;
            sums.z += obs_weight[n] > 0.0 ? 1.0 - trust : 0.0;
        }
    }
    return sums;
}

// Sets each observation's trust at roughness r; returns what those not believed cost, in units of the residual.
float disbelieve(float r) {
#define GROUP(k, first, end) prepare_group(k, first, end, r);
    EACH_GROUP
#undef GROUP
    vec3 sums = vec3(0.0);
    float spread = 1.0;
    for (int i = 0; i <= CALMER; i++) {
#ifdef METALLIC
        if (i == 0 || i == CALMER) settle();
#endif
        CHANNEL weight = CHANNEL(1e-20), albedo = CHANNEL(0.0);
#define GROUP(k, first, end) add_mean(k, first, end, weight, albedo);
        EACH_GROUP
#undef GROUP
        albedo = clamp(albedo / weight, 0.0, 1.0);
        float scale = i == 0 ? -1.0 : max(pow(spread, 1.0 - float(i) / float(CALMER)), 1.0);
        sums = vec3(0.0);
#define GROUP(k, first, end) sums += trust_group(k, first, end, sum(albedo * channel_of(k)), scale);
        EACH_GROUP
#undef GROUP
        if (i == 0) spread = sums.x / max(obs_total, 1.0);
        if (i == 0 && spread < 4.0) i = CALMER - 1;  // nothing is far off
    }
    fit_outliers = sums.z;
    return sums.y * obs_variance;
}
