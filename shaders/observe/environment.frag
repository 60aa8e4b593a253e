// Light from all around, or from meshes that glow, on every pixel, of one batch of directions: irradiance, and what the specular lobe returns at
// nodes of roughness (twin: node_values in irpso_addon/core/shading/environment.py).  Batches add up.
//
// Defines: FIRST_NODE, NODE_COUNT (the nodes of this draw; 0 where irradiance alone is wanted), EACH_NODE (one of NODES_0 to
// NODES_6, by their count), NODE_ALPHA2 (of all), IRRADIANCE where that is wanted too, EMITTERS for patches of meshes.
#include "include/brdf.glsl"
#include "include/pixel.glsl"
#include "observe/environment.glsl"
uniform usampler2D u_lit[4];     // as observe/environment_lit.frag leaves them

const float alpha2_of[] = float[](NODE_ALPHA2);

// Unrolled, and each node's sums and root are variables of their own: compilers leave a loop around a loop, and what is
// written to an array there, even at a constant place, a software renderer writes pixel by pixel (decision 0018).
#define NODES_0
#define NODES_1 NODE(0, sum_0, root_0)
#define NODES_2 NODES_1 NODE(1, sum_1, root_1)
#define NODES_3 NODES_2 NODE(2, sum_2, root_2)
#define NODES_4 NODES_3 NODE(3, sum_3, root_3)
#define NODES_5 NODES_4 NODE(4, sum_4, root_4)
#define NODES_6 NODES_5 NODE(5, sum_5, root_5)

#ifdef IRRADIANCE
layout(location = 0) out vec4 o_irradiance;  // RGB, W/m^2; of their mean what soft shadows leave in doubt
#if NODE_COUNT > 0
layout(location = 1) out vec4 o_node[NODE_COUNT];  // RGB, W/(m^2 sr), at IOR 1.5; mean of the channels without Fresnel
#endif
#else
layout(location = 0) out vec4 o_node[NODE_COUNT];
#endif

vec3 V, d_v_dx, d_v_dy;  // the last: per pixel step, of the direction to the camera
float cos_v;

#define NODE(k, sum, root) vec4 sum; float root;  // what o_node[k] is to be; lambda_root to the camera
EACH_NODE
#undef NODE
#ifdef IRRADIANCE
vec4 irradiance;                 // what o_irradiance is to be
#endif

// Of the batch's directions, 16 in each.
uvec4 lit_0, lit_1, lit_2, lit_3;

// Of the batch's n-th direction.
uint lit_of(int n) {
    uvec4 lit = n < 32 ? (n < 16 ? lit_0 : lit_1) : (n < 48 ? lit_2 : lit_3);
    return lit[(n >> 2) & 3] >> uint(8 * (n & 3)) & 255u;
}

// Which of 16 directions light a pixel: a bit each.
uint some_of(uvec4 lit) {
    lit = (lit | lit >> 4) & 0x0F0F0F0Fu;  // whether any bit of a byte is set
    lit = (lit | lit >> 2) & 0x03030303u;
    lit = (lit | lit >> 1) & 0x01010101u;
    lit = (lit * 0x01020408u) >> 24 & 15u;  // side by side
    return lit.x | lit.y << 4 | lit.z << 8 | lit.w << 12;
}

// Whether the sharpest lobe of this draw sees more of a direction than where it is.
bool wide(Direction d) {
    vec3 H = d.toward + V;
    float square = max(dot(H, H), 1e-12);
    vec3 off = cross(N, H);
    return dot(N, d.toward) > -2.0 * d.spread && d.power != vec3(0.0) &&
        (close_by(d) || d.spread * d.spread > SHARP * (dot(off, off) + alpha2_of[FIRST_NODE] * square));
}

// D / (1 + Lambda_l + Lambda_v), over two, of a disc of half vectors.
float lobe(float alpha2, vec2 disc, float tan2, float root) {
    vec2 D = D_ggx_disc_ratio(alpha2, disc.x, disc.y);
    return D.x / (D.y * (lambda_root(alpha2, tan2) + root));  // one division
}

void add(Direction d, float share) {
    float middle = dot(N, d.toward);
    // Of what lies across the horizon only a part is above; nor does the horizon lie alike all over the pixel.
    float turned = turn(d.toward);
    float cos_l = clamped_mean(middle, sqrt(3.0 * (d.spread * d.spread * max(1.0 - middle * middle, 0.0) +
                                                   turned * turned)));
    if (cos_l <= 0.0) return;
    cos_l = max(cos_l, 1e-3);
    vec3 arrives = d.power * (cos_l * share);
    vec3 H = d.toward + V;
    float inv = inversesqrt(max(dot(H, H), 1e-12));
    H *= inv;
    vec3 cross_off = cross(N, H), off = H - N * dot(N, H);
    float sin2h = dot(cross_off, cross_off);
    // Of the half vector about the normal, over the direction's own spread and over the pixel.
    float variance = d.spread * d.spread * inv * inv;
    vec3 a = (d_v_dx - H * dot(H, d_v_dx)) * inv - dx, b = (d_v_dy - H * dot(H, d_v_dy)) * inv - dy;
    float pixel = u_footprint * u_footprint / 12.0;
    float along_a = dot(off, a), along_b = dot(off, b);
    float half_trace = variance + 0.5 * pixel * (dot(a, a) + dot(b, b));
    vec2 disc = disc_of(sin2h, half_trace, variance * sin2h + pixel * (along_a * along_a + along_b * along_b));
    float fresnel = F_dielectric(dot(V, H)), grey = dot(arrives, vec3(1.0 / 3.0));
    vec4 sent = vec4(arrives * fresnel, grey) * (0.5 / (cos_l * cos_v));
    float tan2 = 1.0 / (cos_l * cos_l) - 1.0;
#define NODE(k, sum, root) sum += lobe(alpha2_of[FIRST_NODE + k], disc, tan2, root) * sent;
    EACH_NODE
#undef NODE
#ifdef IRRADIANCE
    // Doubt: all of it, where half arrives; of light at the terminator as much as of what hardly arrives.
    irradiance += vec4(arrives, 4.0 * (cos_l < MIN_COS_L ? 1.0 : 1.0 - share) * grey);
#endif
}

void main() {
    ivec2 here = ivec2(gl_FragCoord.xy);
    Pixel pixel;
    if (!load_pixel(here, pixel)) discard;
    P = pixel.P;
    N = pixel.N;
    V = toward_camera(pixel.P);
    cos_v = clamp(dot(N, V), 1e-3, 1.0);
    dx = pixel.dNdx;
    dy = pixel.dNdy;
    float near = u_orthographic ? 0.0 : 1.0 / max(distance(u_camera_position, pixel.P), 1e-9);
    d_v_dx = (V * dot(V, pixel.dPdx) - pixel.dPdx) * near;
    d_v_dy = (V * dot(V, pixel.dPdy) - pixel.dPdy) * near;
    float tan2_v = 1.0 / (cos_v * cos_v) - 1.0;
#define NODE(k, sum, root) sum = vec4(0.0); root = lambda_root(alpha2_of[FIRST_NODE + k], tan2_v);
    EACH_NODE
#undef NODE
#ifdef IRRADIANCE
    irradiance = vec4(0.0);
#endif
    // One loop visits directions, parts and their parts: pixels that run together are at different ones, and none waits
    // for the parts of another.
    int level = 0, at = 0, first = 0;  // a part's level, its place there, and the level's
    lit_0 = texelFetch(u_lit[0], here, 0);
    lit_1 = texelFetch(u_lit[1], here, 0);
    lit_2 = texelFetch(u_lit[2], here, 0);
    lit_3 = texelFetch(u_lit[3], here, 0);
    Batch waiting = Batch(some_of(lit_0) | some_of(lit_1) << 16, some_of(lit_2) | some_of(lit_3) << 16);
    float share = 0.0;
    while (true) {
        if (level == 0) {
            if (!some(waiting)) break;
            int n = taken_from(waiting);
            at = u_first + n;
            share = float(lit_of(n)) / 255.0;
        }
        Direction d = direction(first + at);
        if (level < LEVELS && wide(d)) {
            level++;
            at *= PARTS;
            first = first * PARTS + u_all;
            continue;
        }
        add(d, share);
        at++;
        while (level > 0 && at % PARTS == 0) {
            level--;
            at /= PARTS;
            first = (first - u_all) / PARTS;
        }
    }
#define NODE(k, sum, root) o_node[k] = sum;
    EACH_NODE
#undef NODE
#ifdef IRRADIANCE
    o_irradiance = irradiance;
#endif
}
