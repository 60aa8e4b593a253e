// What a lobe returns of an environment, between nodes of roughness: Catmull and Rom's cubic through the logarithms
// (twin: at_roughness in irpso_addon/core/shading/environment.py).
struct NodePlace { int node; float t, d_t; };  // between node and the next; d_t: derivative of t by roughness

NodePlace node_place(float r) {
    float at = log(clamp(r, ROUGHNESS_MIN, 1.0) / ROUGHNESS_MIN) * (float(ENVIRONMENT_NODES - 1) / log(ROUGHNESS_RANGE));
    int node = min(int(at), ENVIRONMENT_NODES - 2);
    return NodePlace(node, at - float(node), float(ENVIRONMENT_NODES - 1) / (log(ROUGHNESS_RANGE) * max(r, ROUGHNESS_MIN)));
}

// Value and derivative by roughness, from the logarithms at nodes -1, 0, 1 and 2 from the place.
void node_curve(NodePlace p, vec3 before, vec3 low, vec3 high, vec3 after, out vec3 value, out vec3 d_value) {
    if (p.node == 0) before = 2.0 * low - high;
    if (p.node == ENVIRONMENT_NODES - 2) after = 2.0 * high - low;
    vec3 a = 0.5 * (high - before), b = 0.5 * (after - low), rise = high - low;
    vec3 square = 3.0 * rise - 2.0 * a - b, cube = a + b - 2.0 * rise;
    value = exp(low + p.t * (a + p.t * (square + p.t * cube)));
    d_value = value * p.d_t * (a + p.t * (2.0 * square + 3.0 * p.t * cube));
}

// The same of one channel; logs: at those nodes.
void node_curve(NodePlace p, vec4 logs, out float value, out float d_value) {
    if (p.node == 0) logs.x = 2.0 * logs.y - logs.z;
    if (p.node == ENVIRONMENT_NODES - 2) logs.w = 2.0 * logs.z - logs.y;
    float a = 0.5 * (logs.z - logs.x), b = 0.5 * (logs.w - logs.y), rise = logs.z - logs.y;
    float square = 3.0 * rise - 2.0 * a - b, cube = a + b - 2.0 * rise;
    value = exp(logs.y + p.t * (a + p.t * (square + p.t * cube)));
    d_value = value * p.d_t * (a + p.t * (2.0 * square + 3.0 * p.t * cube));
}
