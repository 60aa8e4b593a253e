// Rival: dense search on a grid in log roughness, then golden section around the best node.  With two lobes a grid over
// the pairs r1 < r2, then golden sections along the two roughnesses in turn.
#include "include/random.glsl"
#include "solve/observations.glsl"
#if LOBES == 2
#include "solve/particle_two.glsl"
#else
#include "solve/particle.glsl"
#endif
uniform int u_nodes;
uniform int u_steps;

const float GOLDEN = 0.6180339887;

float node(float i) { return ROUGHNESS_MIN * pow(1.0 / ROUGHNESS_MIN, clamp(i / float(u_nodes - 1), 0.0, 1.0)); }

// Golden section between two roughnesses along one axis of r.
ROUGH narrow(ROUGH r, ROUGH axis, float low, float high) {
    float a = high - GOLDEN * (high - low), b = low + GOLDEN * (high - low);
    float fa = residual_at(r + axis * (a - r)), fb = residual_at(r + axis * (b - r));
    for (int i = 0; i < u_steps; i++) {
        if (fa < fb) {
            high = b;
            b = a;
            fb = fa;
            a = high - GOLDEN * (high - low);
            fa = residual_at(r + axis * (a - r));
        } else {
            low = a;
            a = b;
            fa = fb;
            b = low + GOLDEN * (high - low);
            fb = residual_at(r + axis * (b - r));
        }
    }
    return r + axis * (0.5 * (low + high) - r);
}

void kernel() {
    out_0 = vec4(0.5);
    if (!load_observations()) return;
    float least = 1e30;
#if LOBES == 2
    vec2 best = vec2(0.0);
    for (int i = 0; i < u_nodes - 1; i++) for (int j = i + 1; j < u_nodes; j++) {
        float residual = residual_at(vec2(node(float(i)), node(float(j))));
        if (residual < least) {
            least = residual;
            best = vec2(float(i), float(j));
        }
    }
    vec2 r = vec2(node(best.x), node(best.y));
    vec2 low = vec2(node(best.x - 1.0), node(best.y - 1.0)), high = vec2(node(best.x + 1.0), node(best.y + 1.0));
    for (int i = 0; i < 3; i++) {  // each time about the last found, half as wide
        r = narrow(r, vec2(1.0, 0.0), low.x, high.x);
        r = narrow(r, vec2(0.0, 1.0), low.y, high.y);
        vec2 half_width = 0.25 * (high - low);
        low = max(r - half_width, ROUGHNESS_MIN);
        high = min(r + half_width, 1.0);
    }
    out_0 = vec4(ordered(r), r.x <= r.y ? evaluate(r, 0.5).weight : evaluate(r.yx, 0.5).weight, 0.0);
#else
    float best = 0.0;
    for (int i = 0; i < u_nodes; i++) {
        float residual = residual_at(node(float(i)));
        if (residual < least) {
            least = residual;
            best = float(i);
        }
    }
    out_0 = vec4(narrow(node(best), 1.0, node(best - 1.0), node(best + 1.0)), 0.0, 0.0, 0.0);
#endif
}
