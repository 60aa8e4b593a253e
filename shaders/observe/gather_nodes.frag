// Four nodes of what a lobe returns of an environment, copied from the pixels matched to the texels.
uniform sampler2D u_match;
uniform sampler2D u_nodes;   // ENVIRONMENT_COLUMNS nodes side by side, rows of them one above the other
uniform int u_node_row;      // which row
uniform ivec2 u_size;        // of a node's part
uniform int u_channel;       // 0, 1, 2; -1: the mean of the three; 3: the cosine in their place
uniform int u_row;

layout(location = 0) out vec4 o_nodes;  // logarithms of 1/sr; or cosines

void main() {
    vec4 match = texelFetch(u_match, ivec2(gl_FragCoord.xy) - ivec2(0, u_row), 0);
    o_nodes = vec4(0.0);
    if (match.w <= 0.0) return;
    for (int i = 0; i < 4; i++) {
        vec4 node = texelFetch(u_nodes, ivec2(match.xy) + u_size * ivec2(i, u_node_row), 0);
        float value = u_channel < 0 ? dot(node.rgb, vec3(1.0 / 3.0)) : node[u_channel];
        o_nodes[i] = u_channel == 3 ? value : log(max(value, ENVIRONMENT_LEAST));
    }
}
