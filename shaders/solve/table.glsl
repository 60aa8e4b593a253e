// Residuals of a texel at 32 roughnesses, in units of its noise: what it can say to its neighbours.
#include "solve/fit.glsl"
#include "solve/nodes.glsl"
uniform sampler2D u_valleys;  // whole map
uniform sampler2D u_support;

vec4 node_costs(int i, vec4 valleys, float price, float degrees, float around, float trust) {
    vec4 cost;
    for (int j = 0; j < 4; j++) {
        cost[j] = trust * data_cost(max(evaluate(node_roughness(float(4 * i + j))).x - price, 0.0), valleys.y, degrees, around);
    }
    return max(cost, 0.0);
}

void kernel() {
    out_0 = out_1 = out_2 = out_3 = out_4 = out_5 = out_6 = out_7 = vec4(0.0);
    if (!load_observations()) return;
    vec4 valleys = texelFetch(u_valleys, texel_here(), 0), support = texelFetch(u_support, texel_here(), 0);
    float around = noise_around(u_noise, texel_here(), textureSize(u_valleys, 0));
    float trust = belief(support.y, obs_share), price = 0.0;
#ifdef ROBUST
    obs_variance = around;
    price = evaluate(valleys.x).x - fit_squares;
#endif
    out_0 = node_costs(0, valleys, price, support.z, around, trust);
    out_1 = node_costs(1, valleys, price, support.z, around, trust);
    out_2 = node_costs(2, valleys, price, support.z, around, trust);
    out_3 = node_costs(3, valleys, price, support.z, around, trust);
    out_4 = node_costs(4, valleys, price, support.z, around, trust);
    out_5 = node_costs(5, valleys, price, support.z, around, trust);
    out_6 = node_costs(6, valleys, price, support.z, around, trust);
    out_7 = node_costs(7, valleys, price, support.z, around, trust);
}
