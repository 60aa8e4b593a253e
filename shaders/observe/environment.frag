// Light from all around, or from meshes that glow, on every pixel, of one batch of directions: irradiance, and what the specular lobe returns at
// nodes of roughness (twin: node_values in irpso_addon/core/shading/environment.py).  Batches add up.
//
// Defines: FIRST_NODE, NODE_COUNT (the nodes of this draw), EACH_NODE (one of NODES_1 to NODES_6, by their count),
// NODE_ALPHA2 (of all), IRRADIANCE where that is wanted too, EMITTERS for patches of meshes.
#include "include/brdf.glsl"
#include "include/pixel.glsl"
#include "observe/environment.glsl"
uniform usampler2D u_lit;        // as observe/environment_lit.frag leaves them: 16 directions, then those of the next 16
uniform int u_width;             // of the picture

const float alpha2_of[] = float[](NODE_ALPHA2);

// Unrolled: compilers leave a loop around a loop, and there look up each node's sums by its number.
#define NODES_1 NODE(0)
#define NODES_2 NODES_1 NODE(1)
#define NODES_3 NODES_2 NODE(2)
#define NODES_4 NODES_3 NODE(3)
#define NODES_5 NODES_4 NODE(4)
#define NODES_6 NODES_5 NODE(5)

#ifdef IRRADIANCE
layout(location = 0) out vec4 o_irradiance;  // RGB, W/m^2; of their mean what soft shadows leave in doubt
layout(location = 1) out vec4 o_node[NODE_COUNT];  // RGB, W/(m^2 sr), at IOR 1.5; mean of the channels without Fresnel
#else
layout(location = 0) out vec4 o_node[NODE_COUNT];
#endif

vec3 V, d_v_dx, d_v_dy;  // the last: per pixel step, of the direction to the camera
float cos_v, root_v[NODE_COUNT];

// Of the batch's n-th direction.
uint lit_of(ivec2 here, int n) {
    uvec4 lit = texelFetch(u_lit, ivec2(here.x + (n >> 4) * u_width, here.y), 0);
    return lit[(n >> 2) & 3] >> uint(8 * (n & 3)) & 255u;
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
    vec4 sent = vec4(arrives * fresnel, grey) / (2.0 * cos_l * cos_v);
    float tan2 = 1.0 / (cos_l * cos_l) - 1.0;
#define NODE(k) o_node[k] += lobe(alpha2_of[FIRST_NODE + k], disc, tan2, root_v[k]) * sent;
    EACH_NODE
#undef NODE
#ifdef IRRADIANCE
    // Doubt: all of it, where half arrives; of light at the terminator as much as of what hardly arrives.
    o_irradiance += vec4(arrives, 4.0 * (cos_l < MIN_COS_L ? 1.0 : 1.0 - share) * grey);
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
    for (int k = 0; k < NODE_COUNT; k++) {
        o_node[k] = vec4(0.0);
        root_v[k] = lambda_root(alpha2_of[FIRST_NODE + k], 1.0 / (cos_v * cos_v) - 1.0);
    }
#ifdef IRRADIANCE
    o_irradiance = vec4(0.0);
#endif
    // One loop visits directions, parts and their parts: pixels that run together are at different ones, and none waits
    // for the parts of another.
    int n = 0, level = 0, at = 0, first = 0;  // a direction of the batch; a part's level, its place there, and the level's
    uint lit = 0u;
    while (true) {
        while (level == 0 && n < u_count && (lit = lit_of(here, n)) == 0u) n++;
        if (n >= u_count) break;
        if (level == 0) at = u_first + n;
        Direction d = direction(first + at);
        if (level < LEVELS && wide(d)) {
            level++;
            at *= PARTS;
            first = first * PARTS + u_all;
            continue;
        }
        add(d, float(lit) / 255.0);
        at++;
        while (level > 0 && at % PARTS == 0) {
            level--;
            at /= PARTS;
            first = (first - u_all) / PARTS;
        }
        if (level == 0) n++;
    }
}
