// The roughness nodes of the residual tables, and the noise that gives them their unit.
uniform sampler2D u_noise;  // as solve/noise.frag leaves it, made coarser
const int NODES = 32;

float node_roughness(float i) { return ROUGHNESS_MIN * pow(ROUGHNESS_RANGE, i / float(NODES - 1)); }

float roughness_node(float r) { return log(r / ROUGHNESS_MIN) / log(ROUGHNESS_RANGE) * float(NODES - 1); }

// The noise's variance is unknown: an inverse-gamma prior worth NOISE_PRIOR degrees of freedom about
// the typical value `around`, integrated out, turns the sum of squares into a logarithm (Student's t).
// A texel with few observations, which may fit them all by accident, thus never shouts down its
// neighbours.
const float NOISE_PRIOR = 4.0;

// Minus the logarithm of the likelihood of a residual, relative to that of the best.
float data_cost(float residual, float best, float degrees, float around) {
    float typical = NOISE_PRIOR * around;
    return 0.5 * (degrees + NOISE_PRIOR) * log(max((residual + typical) / (best + typical), 1e-6));
}

// Derivative of data_cost by the residual.
float data_slope(float residual, float degrees, float around) {
    return 0.5 * (degrees + NOISE_PRIOR) / (residual + NOISE_PRIOR * around);
}

// How much of what a texel's data say is believed: nothing from edges alone, all from three good
// observations on; and only its share of a pixel that it has in common with other texels.
float belief(float observations, float share) {
    return share * clamp(0.5 * (observations - 1.0), 0.0, 1.0);
}

uniform float u_noise_floor;
uniform float u_noise_unknown;  // variance to assume where no camera has views enough to tell

// The typical variance around a texel, from the map of gpu/solve/neighbours.py.
float noise_around(sampler2D noise, ivec2 texel, ivec2 size) {
    vec2 at = (vec2(texel) + 0.5) / vec2(size) * vec2(textureSize(noise, 0)) - 0.5;
    ivec2 corner = ivec2(floor(at)), last = textureSize(noise, 0) - 1;
    vec2 f = at - vec2(corner);
    vec2 sum = vec2(log(u_noise_unknown), 1.0) * 1e-4;
    for (int j = 0; j < 4; j++) {
        ivec2 d = ivec2(j & 1, j >> 1);
        vec4 n = texelFetch(noise, clamp(corner + d, ivec2(0), last), 0);
        sum += (d.x == 1 ? f.x : 1.0 - f.x) * (d.y == 1 ? f.y : 1.0 - f.y) * n.a * vec2(n.r, 1.0);
    }
    return max(exp(sum.x / sum.y), u_noise_floor * u_noise_floor);
}

#ifdef JOINT
uniform vec3 u_joint_roughness;  // of the material; where its parts differ, of each
uniform float u_joint_strength;

// log(r / the nearest of the material's).
float joint_off(float r) {
    vec3 off = log(r / u_joint_roughness), far = abs(off);
    float least = min(far.x, min(far.y, far.z));
    return far.x == least ? off.x : (far.y == least ? off.y : off.z);
}

// Minus the logarithm of the material's prior: its texels' roughness is normal about the joint one, in the logarithm.
float joint_cost(float r) {
    float off = joint_off(r);
    return u_joint_strength * off * off;
}
#endif
