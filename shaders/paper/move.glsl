// Method `paper`: one particle of every texel's swarm moves; equations (2) to (4) of Nagano, Collins,
// Chen and Nakano, "GPU-Based Inverse Rendering With Multi-Objective Particle Swarm Optimization".
// Every number is searched: base colour and roughness, with two lobes also the second and the weight.
//
// The particle that moves is the same one in all texels, so that its textures alone are bound: those it
// is read from and spare ones that it is written to.  docs/paper.md tells what else differs from the paper.
//
// Defines: those of solve/observations.glsl.
#include "include/random.glsl"
#include "solve/observations.glsl"
uniform sampler2D u_facts;          // shaders/paper/prepare.glsl
uniform sampler2D u_position;       // of the particle that moves: base colour, roughness1
uniform sampler2D u_velocity;       // of the same numbers
uniform sampler2D u_own;            // its own best so far
uniform sampler2D u_own_more;       // that best's roughness2, weight, fitness
#if LOBES == 2
uniform sampler2D u_tail;           // roughness2 and weight of position, of velocity
#endif
uniform sampler2D u_best;           // the texel's best: base colour, roughness1; all 0: no swarm
uniform sampler2D u_best_more;      // its roughness2, weight, fitness; evaluations made
uniform int u_particle;
uniform int u_pass;                 // 0: the particle is put in its first place
uniform int u_seed;
uniform vec3 u_pull;                // c1, c2, c3
uniform int u_reach;                // H / 2
uniform float u_done;               // fitness below which a swarm rests
uniform float u_constriction, u_velocity_max;
uniform bool u_bounded;

struct Point { vec4 head; vec2 tail; };  // base colour, roughness1; roughness2, weight of lobe 1

const vec4 HEAD_LOW = vec4(0.0, 0.0, 0.0, ROUGHNESS_MIN);
const vec2 TAIL_LOW = vec2(ROUGHNESS_MIN, 0.0);

// Adds a group's weighted squared errors to the sum.
void add_group(int k, int first, int end, Point p, inout float sum) {
    ivec2 at = texel_here() + ivec2(0, k * u_tile_height);
    float cos_v = texelFetch(u_facts, at, 0).x;
    Toward one = toward(p.head.w, cos_v);
#if LOBES == 2
    Toward two = toward(p.tail.x, cos_v);
#endif
    at = texel_here() + ivec2(0, (GROUPS + first * (1 + LIGHTS)) * u_tile_height);
    for (int n = first; n < end; n++) {
        vec4 f = texelFetch(u_facts, at, 0);
        at.y += u_tile_height;
        for (int l = 0; l < LIGHTS; l++) {  // the first elements of the arrays serve every observation
            vec4 lobe = texelFetch(u_facts, at, 0);
            at.y += u_tile_height;
            lobe_sin2h[l] = lobe.x;
#ifdef SPREAD
            lobe_spread[l] = lobe.y;
#endif
            lobe_tan2[l] = lobe.z;
            lobe_factor[l] = lobe.w;
        }
        float a = one.diffuse, s, unused;
        specular_d(0, p.head.w, one, s, unused);
#if LOBES == 2
        float s2;
        specular_d(0, p.tail.x, two, s2, unused);
        s = mix(s2, s, p.tail.y);
        a = mix(two.diffuse, a, p.tail.y);
#endif
#if CHANNELS == 3
        float error = f.x - (p.head[GROUP_CHANNEL[k]] * a + s);
        sum += f.w * error * error;
#else
        vec3 error = f.rgb - (p.head.rgb * a + s);
        sum += f.w * dot(error, error) / 3.0;
#endif
    }
}

// Mean over observations and channels of the squared error, relative to that of the signal.
float fitness(Point p) {
    float sum = 0.0;
    for (int k = 0; k < GROUPS; k++) group_seen[k] = true;
#define GROUP(k, first, end) add_group(k, first, end, p, sum);
    EACH_GROUP
    return sum;
}

// Mean of the texels' bests in the window, of those that have a swarm: equation (4)'s sum over H^2.
Point neighbours() {
    ivec2 low = max(texel_here() - u_reach, 0), high = min(texel_here() + u_reach, textureSize(u_best, 0) - 1);
    Point sum = Point(vec4(0.0), vec2(0.0));
    float count = 0.0;
    for (int y = low.y; y <= high.y; y++) {
        for (int x = low.x; x <= high.x; x++) {
            vec4 head = texelFetch(u_best, ivec2(x, y), 0);
            sum.head += head;
            count += float(head.w != 0.0);
#if LOBES == 2
            sum.tail += texelFetch(u_best_more, ivec2(x, y), 0).xy;
#endif
        }
    }
    return Point(sum.head / max(count, 1.0), sum.tail / max(count, 1.0));
}

// Twelve random numbers, of this texel, particle and pass.
struct Dice { vec4 a, b; vec2 c, d; };
Dice throw_dice() {
    ivec2 texel = texel_here() + u_tile;
    vec3 one = random3(texel, u_particle, u_pass, u_seed), two = random3(texel, u_particle + 64, u_pass, u_seed);
    vec3 three = random3(texel, u_particle + 128, u_pass, u_seed);
#if LOBES == 2
    vec3 four = random3(texel, u_particle + 192, u_pass, u_seed);
#else
    vec3 four = vec3(0.0);
#endif
    return Dice(vec4(one, two.x), vec4(two.yz, three.xy), vec2(three.z, four.x), four.yz);
}

// Equations (2) and (3); with limits, a wall of the box takes the velocity that ran into it, and lobes that
// passed each other are renamed.
void move(inout Point x, inout Point v, Point own, Point best) {
    Dice r = throw_dice();
    Point mean = x;
    if (u_pull.z > 0.0) mean = neighbours();
    vec4 head = v.head + u_pull.x * r.a * (own.head - x.head) + u_pull.y * r.b * (best.head - x.head)
              + u_pull.z * (mean.head - x.head);
    vec2 tail = v.tail + u_pull.x * r.c * (own.tail - x.tail) + u_pull.y * r.d * (best.tail - x.tail)
              + u_pull.z * (mean.tail - x.tail);
    v.head = clamp(u_constriction * head, -u_velocity_max, u_velocity_max);
    v.tail = clamp(u_constriction * tail, -u_velocity_max, u_velocity_max);
    Point moved = Point(x.head + v.head, x.tail + v.tail);
    x = moved;
    if (!u_bounded) return;
    x.head = clamp(x.head, HEAD_LOW, vec4(1.0));
    v.head *= vec4(equal(x.head, moved.head));
#if LOBES == 2
    x.tail = clamp(x.tail, TAIL_LOW, vec2(1.0));
    v.tail *= vec2(equal(x.tail, moved.tail));
    if (x.head.w > x.tail.x) {
        x = Point(vec4(x.head.rgb, x.tail.x), vec2(x.head.w, 1.0 - x.tail.y));
        v = Point(vec4(v.head.rgb, v.tail.x), vec2(v.head.w, -v.tail.y));
    }
#endif
}

void kernel() {
    ivec2 at = texel_here();
    out_0 = out_1 = out_2 = out_3 = out_4 = out_5 = vec4(0.0);
#if LOBES == 2
    out_6 = vec4(0.0);
#endif
    if (texelFetch(u_facts, at, 0).y == 0.0) return;
    vec4 best = texelFetch(u_best, at, 0), best_more = texelFetch(u_best_more, at, 0);
    Point x = Point(vec4(0.0), vec2(0.0)), v = x;
    vec4 own = vec4(0.0), own_more = vec4(0.0);
    bool rests = best_more.w > 0.0 && best_more.z <= u_done;
    if (u_pass == 0) {
        Dice r = throw_dice();
        x = Point(mix(HEAD_LOW, vec4(1.0), r.a), mix(TAIL_LOW, vec2(1.0), r.c));
#if LOBES == 2
        if (x.head.w > x.tail.x) x = Point(vec4(x.head.rgb, x.tail.x), vec2(x.head.w, x.tail.y));
#endif
        own_more.z = 1e30;  // no best yet
    } else {
        x.head = texelFetch(u_position, at, 0);
        v.head = texelFetch(u_velocity, at, 0);
        own = texelFetch(u_own, at, 0);
        own_more = texelFetch(u_own_more, at, 0);
#if LOBES == 2
        vec4 tail = texelFetch(u_tail, at, 0);
        x.tail = tail.xy;
        v.tail = tail.zw;
#endif
        if (!rests) move(x, v, Point(own, own_more.xy), Point(best, best_more.xy));
    }
    if (!rests) {
        float f = fitness(x);
        if (f < own_more.z) {
            own = x.head;
            own_more = vec4(x.tail, f, 0.0);
        }
        if (f < best_more.z || best_more.w == 0.0) {
            best = x.head;
            best_more.xyz = vec3(x.tail, f);
        }
        best_more.w += 1.0;
    }
#if LOBES == 1
    best_more.xy = vec2(best.w, 1.0);
#endif
    out_0 = best;
    out_1 = best_more;
    out_2 = x.head;
    out_3 = v.head;
    out_4 = own;
    out_5 = own_more;
#if LOBES == 2
    out_6 = vec4(x.tail, v.tail);
#endif
}
