// The roughness nodes of the residual tables, and the noise that gives them their unit.
const int NODES = 32;
const float TABLE_MAX = 60.0;  // a texel cannot veto a roughness beyond e^-60

float node_roughness(float i) { return 0.05 * pow(20.0, i / float(NODES - 1)); }

float roughness_node(float r) { return log(r / 0.05) / log(20.0) * float(NODES - 1); }

// Variance of one observation's relative error: what the best fit leaves, over its degrees of
// freedom, and a floor for what the model leaves out (pixel footprint, image interpolation).
float noise_variance(float residual, float observations, float groups, float noise_floor) {
    float free = max(observations - groups - 1.0, 0.25);
    return residual / free + noise_floor * noise_floor;
}
