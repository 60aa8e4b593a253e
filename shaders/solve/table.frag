// Residuals of a texel at 32 roughnesses, in units of its noise: what it can say to its neighbours.
#include "solve/fit.glsl"
#include "solve/nodes.glsl"
uniform sampler2D u_valleys;  // whole map
uniform sampler2D u_support;
uniform sampler2D u_noise;

layout(location = 0) out vec4 o_table[8];

void main() {
    for (int i = 0; i < 8; i++) o_table[i] = vec4(0.0);
    if (!load_observations()) return;
    vec4 valleys = texelFetch(u_valleys, texel_here(), 0), support = texelFetch(u_support, texel_here(), 0);
    float around = noise_around(u_noise, texel_here(), textureSize(u_valleys, 0));
    float trust = belief(support.y, obs_share);
    for (int i = 0; i < 8; i++) {
        vec4 t;
        for (int j = 0; j < 4; j++) {
            t[j] = trust * data_cost(evaluate(node_roughness(float(4 * i + j))).x, valleys.y, support.z, around);
        }
        o_table[i] = max(t, 0.0);
    }
}
