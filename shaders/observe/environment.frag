// Light from all around, or from meshes that glow, on every pixel, of one batch of directions: irradiance, and what the specular lobe returns at
// nodes of roughness (twin: node_values in irpso_addon/core/shading/environment.py).  Batches add up.
//
// Defines: FIRST_NODE, NODE_COUNT (the nodes of this draw), NODE_ALPHA2 (of all), IRRADIANCE where that is wanted too,
// EMITTERS for patches of meshes.
#include "include/brdf.glsl"
#include "include/pixel.glsl"
#include "include/shadow.glsl"
uniform sampler2D u_facet;
uniform sampler2D u_shadow;      // linear depth from u_center on, nearest: the batch's maps
uniform int u_first;             // direction of the batch
uniform int u_count;             // directions in it
uniform int u_all;               // directions in all

const float LIT_EDGE = 0.02;     // share of a direction's middle between which and the rest an edge of its shadow lies
const float alpha2_of[] = float[](NODE_ALPHA2);

#ifdef IRRADIANCE
layout(location = 0) out vec4 o_irradiance;  // RGB, W/m^2; of their mean what comes from where a shadow's edge passes
layout(location = 1) out vec4 o_node[NODE_COUNT];  // RGB, W/(m^2 sr), at IOR 1.5; mean of the channels without Fresnel
#else
layout(location = 0) out vec4 o_node[NODE_COUNT];
#endif

vec3 P, N, V, dx, dy, d_v_dx, d_v_dy;  // the last: per pixel step, of the normal and of the direction to the camera
float cos_v, root_v[NODE_COUNT];

struct Direction { vec3 toward; float spread; vec3 power; };

ivec2 texel_of(int at) {
    return ivec2(uint(at) % uint(DATA_WIDTH), uint(at) / uint(DATA_WIDTH));
}

ivec2 corner_of(int map) {
    return SHADOW_SIDE * ivec2(uint(map) % uint(SHADOW_COLUMNS), uint(map) / uint(SHADOW_COLUMNS));
}

vec3 right_of(vec3 forward) {
    return normalize(cross(forward, abs(forward.z) < 0.9 ? vec3(0.0, 0.0, 1.0) : vec3(0.0, 1.0, 0.0)));
}

// Mean of max(x, 0) where x is spread evenly about a middle.
float clamped_mean(float middle, float half_width) {
    if (abs(middle) >= half_width) return max(middle, 0.0);
    return (middle + half_width) * (middle + half_width) / (4.0 * half_width);
}

#ifdef EMITTERS
#include "observe/from_emitters.glsl"
#else
#include "observe/from_world.glsl"
#endif

// Whether the sharpest lobe of this draw sees more of a direction than where it is.
bool wide(Direction d) {
    vec3 H = d.toward + V;
    float square = max(dot(H, H), 1e-12);
    vec3 off = cross(N, H);
    return dot(N, d.toward) > -2.0 * d.spread && d.power != vec3(0.0) &&
        (close_by(d) || d.spread * d.spread > SHARP * (dot(off, off) + alpha2_of[FIRST_NODE] * square));
}

void add(Direction d, vec2 lit) {
    float middle = dot(N, d.toward);
    // Of what lies across the horizon only a part is above.
    float cos_l = clamped_mean(middle, d.spread * sqrt(3.0 * max(1.0 - middle * middle, 0.0)));
    if (cos_l <= 0.0) return;
    cos_l = max(cos_l, 1e-3);
    vec3 arrives = d.power * (cos_l * lit.x);
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
    float mean = sin2h + 2.0 * variance + pixel * (dot(a, a) + dot(b, b));
    float spread = 2.0 * sqrt(variance * (sin2h + variance) + pixel * (along_a * along_a + along_b * along_b));
    float fresnel = F_dielectric(dot(V, H)), grey = dot(arrives, vec3(1.0 / 3.0));
    float tan2 = 1.0 / (cos_l * cos_l) - 1.0, factor = 1.0 / (2.0 * cos_l * cos_v);
    float half_width = min(spread, mean), low = mean - half_width, high = mean + half_width;
    for (int k = 0; k < NODE_COUNT; k++) {
        float alpha2 = alpha2_of[FIRST_NODE + k];
        float q_low = low * (1.0 - alpha2) + alpha2, q_high = high * (1.0 - alpha2) + alpha2;
        float D = alpha2 * (0.5 / PI) * (1.0 / (q_low * q_low) + 1.0 / (q_high * q_high));
        float shape = D * factor / (lambda_root(alpha2, tan2) + root_v[k]);
        o_node[k] += shape * vec4(arrives * fresnel, grey);
    }
#ifdef IRRADIANCE
    o_irradiance += vec4(arrives, lit.y > LIT_EDGE && lit.y < 1.0 - LIT_EDGE ? grey : 0.0);
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
    vec4 facet = texelFetch(u_facet, here, 0);
    // One loop visits directions, parts and their parts: pixels that run together are at different ones, and none waits
    // for the parts of another.
    int n = 0, i = -1, j = -1;  // a direction of the batch, its part, and the part's; -1: the whole
    vec2 lit = vec2(0.0);
    while (true) {
        while (i < 0 && n < u_count && !above(u_first + n)) n++;
        if (n >= u_count) break;
        int part = (u_first + n) * PARTS_0 + i;
        Direction d = direction(i < 0 ? u_first + n : j < 0 ? u_all + part : u_all * (1 + PARTS_0) + part * PARTS_1 + j);
        if (i < 0) lit = lit_of(n, d, facet);
        if (lit.x > 0.0 && j < 0 && wide(d)) {
            if (i < 0) i = 0;
            else j = 0;
            continue;
        }
        if (lit.x > 0.0) add(d, lit);
        if (j >= 0 && ++j == PARTS_1) {
            j = -1;
            i++;
        } else if (j < 0 && i >= 0) {
            i++;
        } else if (j < 0) {
            n++;
        }
        if (i == PARTS_0) {
            i = -1;
            n++;
        }
    }
}
