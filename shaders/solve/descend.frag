// One level down: a cell's roughness from its own table and its parents' estimate.
// A maximum a posteriori step: the prior is normal about the interpolated parents, cut off at
// u_prior_cut standard units so that an edge costs no more than that.
#include "solve/nodes.glsl"
uniform sampler2D u_table[8];
uniform sampler2D u_parent;  // roughness, variance, -, known (0 or 1); half the size
uniform bool u_top;
uniform float u_step;        // how much roughness may differ from the parents' (standard deviation)
uniform float u_prior_cut;

layout(location = 0) out vec4 o_estimate;  // roughness, variance, -, known
layout(location = 1) out vec4 o_prior;     // mean and variance that the parents gave; spreads()

void parents(out float mean, out float variance) {
    vec2 at = 0.5 * gl_FragCoord.xy - 0.5;
    ivec2 corner = ivec2(floor(at)), last = textureSize(u_parent, 0) - 1;
    vec2 f = at - vec2(corner);
    vec3 sum = vec3(0.0);
    for (int j = 0; j < 4; j++) {
        ivec2 d = ivec2(j & 1, j >> 1);
        vec4 parent = texelFetch(u_parent, clamp(corner + d, ivec2(0), last), 0);
        float w = (d.x == 1 ? f.x : 1.0 - f.x) * (d.y == 1 ? f.y : 1.0 - f.y) * parent.w / parent.y;
        sum += w * vec3(parent.x, parent.y, 1.0);
    }
    mean = sum.z > 0.0 ? sum.x / sum.z : 0.5;
    variance = (sum.z > 0.0 ? sum.y / sum.z : 0.1) + u_step * u_step;
}

// Mean squared distance from r under the posterior: of what lies in other valleys (the one at r being a
// normal of curvature `bend`), and of all, by the nodes alone, for a valley wider than their steps.
vec2 spreads(float cost[NODES], float least, float r, float bend) {
    float here = roughness_node(clamp(r, ROUGHNESS_MIN, 1.0));
    vec2 mass = vec2(sqrt(2.0 * 3.14159265 / max(bend, 1e-3)), 1e-12), square = vec2(0.0);
    for (int i = 0; i < NODES; i++) {
        float at = node_roughness(float(i));
        float share = exp(least - cost[i]) * at;  // steps between nodes grow with roughness
        float off = (at - r) * (at - r);
        bool elsewhere = abs(float(i) - here) > 1.5 && off * max(bend, 1e-3) > 9.0;  // not this valley's own tail
        vec2 counts = vec2(elsewhere ? 0.0966 : 0.0, 1.0);  // ln ROUGHNESS_RANGE / 31: step over roughness
        mass += counts * share;
        square += counts * share * off;
    }
    return square / mass;
}

void main() {
    float mean = 0.5, variance = 0.1;
    if (!u_top) parents(mean, variance);
    float cost[NODES];
    float most = 0.0;
    for (int i = 0; i < 8; i++) {
        vec4 t;
        ivec2 at = ivec2(gl_FragCoord.xy);
        if (i == 0) t = texelFetch(u_table[0], at, 0);
        if (i == 1) t = texelFetch(u_table[1], at, 0);
        if (i == 2) t = texelFetch(u_table[2], at, 0);
        if (i == 3) t = texelFetch(u_table[3], at, 0);
        if (i == 4) t = texelFetch(u_table[4], at, 0);
        if (i == 5) t = texelFetch(u_table[5], at, 0);
        if (i == 6) t = texelFetch(u_table[6], at, 0);
        if (i == 7) t = texelFetch(u_table[7], at, 0);
        for (int j = 0; j < 4; j++) {
            float off = node_roughness(float(4 * i + j)) - mean;
            most = max(most, t[j]);
            cost[4 * i + j] = t[j] + min(0.5 * off * off / variance, u_prior_cut);
        }
    }
    o_prior = vec4(mean, variance, 0.0, variance);
    if (most <= 0.0) {  // nothing observed here
        o_estimate = vec4(mean, variance, 0.0, u_top ? 0.0 : 1.0);
        return;
    }
    int best = 0;
    for (int i = 1; i < NODES; i++) if (cost[i] < cost[best]) best = i;
    int mid = clamp(best, 1, NODES - 2);
    // Parabola through the best node and its neighbours, in roughness.
    float x0 = node_roughness(float(mid - 1)), x1 = node_roughness(float(mid)), x2 = node_roughness(float(mid + 1));
    float s0 = (cost[mid] - cost[mid - 1]) / (x1 - x0), s1 = (cost[mid + 1] - cost[mid]) / (x2 - x1);
    float bend = 2.0 * (s1 - s0) / (x2 - x0);
    float r = bend > 0.0 ? clamp(0.5 * (x0 + x1) - s0 / bend, x0, x2) : node_roughness(float(best));
    o_estimate = vec4(r, min(1.0 / max(bend, 1e-3), variance), 0.0, 1.0);
    o_prior.zw = spreads(cost, cost[best], r, bend);
}
