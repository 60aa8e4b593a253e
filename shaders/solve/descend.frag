// One level down: the roughness of a cell's kinds from their tables and the parents' estimates.
// A maximum a posteriori step: the prior is normal about the interpolated parents, cut off at
// u_prior_cut standard units so that an edge costs no more than that.
// A kind asks the parents' kind of the colour nearest to its own. Where a cell's two kinds may well have the same
// roughness, what they say counts for both.
#include "solve/nodes.glsl"
#include "solve/cells.glsl"
// Of each kind: roughness, variance, differ, 0 where nothing is known, else 1 + spreads().x; half the size.
uniform sampler2D u_parent[2];
uniform sampler2D u_parent_colour[2];  // as u_colour there
uniform bool u_top;
uniform float u_step;        // how much roughness may differ from the parents' (standard deviation)
uniform sampler2D u_typical;  // of each kind: colour, and above it roughness and its variance: a normal prior of a cell
uniform float u_prior_cut;
uniform int u_cell;          // of so many parents in a row, those of others say nothing; 0: all do
uniform float u_evidence;    // how much of its tables counts where it is judged whether a cell's kinds are apart

const float APART = 1.5;    // nats that two roughnesses must explain the kinds better than one
const float FAR = 50.0;     // squared distance of colours that is farther than any
const float OTHER = 0.3;    // standard deviation of a kind's colour, in units of the distance of kinds that are apart
const float SHADE = 0.2;    // in the same units: kinds that are nearer are shades of one

// "differ" is 1 / squared distance of the colours that are apart here, 0 where none are.

// What is typical of this colour: roughness, variance.
vec2 typical_of(vec3 colour) {
    int nearest = 0;
    float least = 1e30;
    for (int i = 0; i < textureSize(u_typical, 0).x; i++) {
        float off = squared(texelFetch(u_typical, ivec2(i, 0), 0).rgb - colour);
        if (off < least) nearest = i;
        least = min(least, off);
    }
    return texelFetch(u_typical, ivec2(nearest, 1), 0).xy;
}

const float UNKNOWN = 0.1;  // variance where nothing else is known

// The four parents of a kind of this colour, interpolated: mean, variance, differ.
vec3 parents(vec3 colour) {
    vec2 at = 0.5 * gl_FragCoord.xy - 0.5;
    ivec2 corner = ivec2(floor(at)), first_parent = ivec2(0), last_parent = textureSize(u_parent[0], 0) - 1;
    vec2 f = at - vec2(corner);
    if (u_cell > 0) {
        first_parent = ivec2(0.5 * gl_FragCoord.xy) / u_cell * u_cell;
        last_parent = first_parent + u_cell - 1;
    }
    vec4 parent[4];
    float weight[4], off[4], differ = 0.0;
    for (int j = 0; j < 4; j++) {
        ivec2 d = ivec2(j & 1, j >> 1), cell = clamp(corner + d, first_parent, last_parent);
        vec4 first = texelFetch(u_parent_colour[0], cell, 0), second = texelFetch(u_parent_colour[1], cell, 0);
        vec2 offs = vec2(first.a > 0.0 ? squared(first.rgb - colour) : FAR,
                         second.a > 0.0 ? squared(second.rgb - colour) : FAR);
        parent[j] = offs.y < offs.x ? texelFetch(u_parent[1], cell, 0) : texelFetch(u_parent[0], cell, 0);
        weight[j] = (d.x == 1 ? f.x : 1.0 - f.x) * (d.y == 1 ? f.y : 1.0 - f.y);
        off[j] = min(offs.x, offs.y);
        differ += weight[j] * parent[j].z;
    }
    vec4 sum = vec4(0.0);
    for (int j = 0; j < 4; j++) {
        // Where kinds are apart, a parent without a kind of about this colour counts little.
        float like = 1e-6 + exp(-min(0.5 / (OTHER * OTHER) * off[j] * differ, 60.0));
        sum += like * weight[j] * min(parent[j].w, 1.0) / parent[j].y
             * vec4(parent[j].x, parent[j].y, max(parent[j].w - 1.0, 0.0), 1.0);
    }
    vec2 typical = typical_of(colour);
    vec3 found = sum.w > 0.0 ? sum.xyz / sum.w : vec3(typical.x, min(typical.y, UNKNOWN), 0.0);
    // Two priors, the parents' and what is typical: their product.
    float share = typical.y / (typical.y + u_step * u_step);  // of the parents'
    // A parent that may be in another valley does not hold its children where it is.  How much it counts beside the other
    // parents is up to the valley's own width: else those would hold them where *they* are.
    float change = max(share * u_step * u_step, share * share * found.z);
    return vec3(mix(typical.x, found.x, share), share * share * found.y + change, differ);
}

vec3 prior_of(int kind) {
    vec3 colour = cell_colour(ivec2(gl_FragCoord.xy), kind).rgb;
    if (!u_top) return parents(colour);
    vec2 typical = typical_of(colour);
    return vec3(typical.x, min(typical.y, UNKNOWN), 0.0);
}

vec4 prior_cost(int i, vec3 prior) {
    vec4 cost;
    for (int j = 0; j < 4; j++) {
        float off = node_roughness(float(4 * i + j)) - prior.x;
        cost[j] = min(0.5 * off * off / prior.y, u_prior_cut);
    }
    return cost;
}

float least_of(vec4 v) { return min(min(v.x, v.y), min(v.z, v.w)); }

// The node of least cost, and about it the least of a parabola, in roughness: (roughness, its curvature).
vec2 lowest(float cost[NODES], out float least) {
    int best = 0;
    for (int i = 1; i < NODES; i++) if (cost[i] < cost[best]) best = i;
    least = cost[best];
    int mid = clamp(best, 1, NODES - 2);
    float x0 = node_roughness(float(mid - 1)), x1 = node_roughness(float(mid)), x2 = node_roughness(float(mid + 1));
    float s0 = (cost[mid] - cost[mid - 1]) / (x1 - x0), s1 = (cost[mid + 1] - cost[mid]) / (x2 - x1);
    float bend = 2.0 * (s1 - s0) / (x2 - x0);
    return vec2(bend > 0.0 ? clamp(0.5 * (x0 + x1) - s0 / bend, x0, x2) : node_roughness(float(best)), bend);
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

// A kind's estimate from its costs under its prior; `said`: whether anything was observed.
vec4 estimate(float cost[NODES], vec3 prior, bool said, out vec2 spread) {
    spread = vec2(0.0, prior.y);
    if (!said) return vec4(prior, u_top ? 0.0 : 1.0);
    float least;
    vec2 low = lowest(cost, least);
    spread = spreads(cost, least, low.x, low.y);
    return vec4(low.x, min(1.0 / max(low.y, 1e-3), prior.y), prior.z, 1.0 + spread.x);
}

#ifdef TEXELS
layout(location = 0) out vec4 o_estimate;  // as u_parent
layout(location = 1) out vec4 o_prior;     // mean and variance that the parents gave; spreads()

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec3 prior = prior_of(0);
    float cost[NODES];
    bool said = false;
    for (int i = 0; i < 8; i++) {
        vec4 own = cell_table(at, 0, i), costs = own + prior_cost(i, prior);
        said = said || any(greaterThan(own, vec4(0.0)));
        for (int j = 0; j < 4; j++) cost[4 * i + j] = costs[j];
    }
    vec2 spread;
    o_estimate = estimate(cost, prior, said, spread);
    o_prior = vec4(prior.xy, spread);
}
#else
layout(location = 0) out vec4 o_first;  // as u_parent
layout(location = 1) out vec4 o_second;

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec4 first = cell_colour(at, 0), second = cell_colour(at, 1);
    vec3 prior_a = prior_of(0), prior_b = prior_of(1);
    float cost_a[NODES], cost_b[NODES];
    vec2 alone = vec2(1e30);
    float together = 1e30;
    for (int i = 0; i < 8; i++) {
        vec4 a = cell_table(at, 0, i), b = cell_table(at, 1, i);
        vec4 one = prior_cost(i, prior_a), two = prior_cost(i, prior_b);
        alone = min(alone, vec2(least_of(u_evidence * a + one), least_of(u_evidence * b + two)));
        together = min(together, least_of(u_evidence * (a + b) + one + two));
    }
    bool both = first.a > 0.0 && second.a > 0.0, apart = both && together - alone.x - alone.y > APART;
    float away = max(squared(first.rgb - second.rgb), 1e-8), other = apart ? 0.0 : 1.0;
    // Kinds that are not apart here: each may still be apart from what lies around, if both are shades of it.
    vec2 differ = vec2(prior_a.z, prior_b.z);
    if (both) differ *= vec2(lessThan(differ * away, vec2(SHADE * SHADE)));
    if (apart) differ = vec2(1.0 / away);
    prior_a.z = differ.x;
    prior_b.z = differ.y;
    bvec2 said = bvec2(false);
    for (int i = 0; i < 8; i++) {
        vec4 a = cell_table(at, 0, i), b = cell_table(at, 1, i);
        vec4 for_a = a + other * b, for_b = b + other * a;
        vec4 one = for_a + prior_cost(i, prior_a), two = for_b + prior_cost(i, prior_b);
        said = bvec2(said.x || any(greaterThan(for_a, vec4(0.0))), said.y || any(greaterThan(for_b, vec4(0.0))));
        for (int j = 0; j < 4; j++) {
            cost_a[4 * i + j] = one[j];
            cost_b[4 * i + j] = two[j];
        }
    }
    vec2 spread;
    o_first = estimate(cost_a, prior_a, said.x, spread);
    o_second = estimate(cost_b, prior_b, said.y, spread);
}
#endif
