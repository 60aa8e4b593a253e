// The roughness nodes of the residual tables, and the noise that gives them their unit.
const int NODES = 32;
const float TABLE_MAX = 60.0;  // a texel cannot veto a roughness beyond e^-60

float node_roughness(float i) { return 0.05 * pow(20.0, i / float(NODES - 1)); }

float roughness_node(float r) { return log(r / 0.05) / log(20.0) * float(NODES - 1); }

// Variance of one observation's relative error: what the best fit leaves over its degrees of freedom,
// drawn towards the typical value around (an inverse-gamma prior worth NOISE_PRIOR degrees), because
// a texel with few observations may fit them all by accident.
const float NOISE_PRIOR = 4.0;

float noise_variance(float residual, float degrees, float around) {
    return (residual + NOISE_PRIOR * around) / (degrees + NOISE_PRIOR);
}

// The typical variance around a texel, from the map that solve/noise.frag and fill/down.frag made.
float noise_around(sampler2D noise, ivec2 texel, ivec2 size, float noise_floor) {
    vec2 at = (vec2(texel) + 0.5) / vec2(size) * vec2(textureSize(noise, 0)) - 0.5;
    ivec2 corner = ivec2(floor(at)), last = textureSize(noise, 0) - 1;
    vec2 f = at - vec2(corner);
    vec2 sum = vec2(0.0, 1e-9);
    for (int j = 0; j < 4; j++) {
        ivec2 d = ivec2(j & 1, j >> 1);
        vec4 n = texelFetch(noise, clamp(corner + d, ivec2(0), last), 0);
        sum += (d.x == 1 ? f.x : 1.0 - f.x) * (d.y == 1 ? f.y : 1.0 - f.y) * n.a * vec2(n.r, 1.0);
    }
    return max(exp(sum.x / sum.y), noise_floor * noise_floor);
}
