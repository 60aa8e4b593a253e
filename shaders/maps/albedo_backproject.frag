// A camera's residuals carried back to the texels it sees, to be added over cameras.
// The first time (FINDING) it also leaves which pixels show a texel: later steps look that up.
#include "include/pixel.glsl"
uniform sampler2D u_texel_position;
uniform sampler2D u_texel_normal;
uniform sampler2D u_residual;  // pixel grid
uniform float u_beyond;        // what a pixel of another UV island counts

layout(location = 0) out vec4 o_update;  // weighted residual sum, weight

// How a pixel shows a texel:
const int NOT = 0;     // it shows another surface
const int BEYOND = 1;  // it is of another UV island
const int OWN = 2;

#ifdef FINDING
uniform sampler2D u_uv;
uniform sampler2D u_uv_slope;
layout(location = 1) out vec4 o_shown;  // how each of the four pixels around shows the texel, two bits each

// Whether the pixel's island has the texel where the pixel, so far away from its projection, would show it.
bool same_island(ivec2 pixel, vec2 away) {
    vec2 size = vec2(textureSize(u_texel_position, 0));
    vec4 slope = texelFetch(u_uv_slope, pixel, 0) * size.xyxy;
    vec2 there = texelFetch(u_uv, pixel, 0).xy * size + away.x * slope.xy + away.y * slope.zw;
    return all(lessThan(abs(there - gl_FragCoord.xy), 1.0 + 0.5 * (abs(slope.xy) + abs(slope.zw))));
}

int shown_by(ivec2 pixel, vec2 away, vec4 p, vec3 n, float slant) {
    if (any(lessThan(pixel, ivec2(0))) || any(greaterThanEqual(pixel, textureSize(u_position, 0)))) return NOT;
    if (!same_surface(p, texelFetch(u_position, pixel, 0), slant, 1.0)) return NOT;
    if (dot(texelFetch(u_normal, pixel, 0).xyz, n) < 0.5) return NOT;  // the other side of a thin wall
    return same_island(pixel, away) ? OWN : BEYOND;
}
#else
uniform sampler2D u_shown;
#endif

void main() {
    ivec2 texel = ivec2(gl_FragCoord.xy);
    vec4 p = texelFetch(u_texel_position, texel, 0);
    vec4 clip = clip_of(p.xyz);
    if (p.w < 0.5 || clip.w <= 0.0) discard;
    vec3 n = texelFetch(u_texel_normal, texel, 0).xyz;
    float cos_v = dot(n, toward_camera(p.xyz));
    if (cos_v <= 0.0) discard;
    vec2 at = (clip.xy / clip.w * 0.5 + 0.5) * vec2(textureSize(u_residual, 0)) - 0.5;
    ivec2 corner = ivec2(floor(at));
    vec2 f = at - vec2(corner);
#ifdef FINDING
    int shown = 0;
    for (int j = 0; j < 4; j++) {
        ivec2 d = ivec2(j & 1, j >> 1);
        shown |= shown_by(corner + d, f - vec2(d), p, n, clamp(cos_v, 0.15, 1.0)) << (2 * j);
    }
    o_shown = vec4(float(shown) / 255.0);
#else
    int shown = int(texelFetch(u_shown, texel, 0).r * 255.0 + 0.5);
#endif
    o_update = vec4(0.0);
    for (int j = 0; j < 4; j++) {
        int how = (shown >> (2 * j)) & 3;
        if (how == NOT) continue;
        ivec2 d = ivec2(j & 1, j >> 1);
        vec4 residual = texelFetch(u_residual, corner + d, 0);
        float w = (d.x == 1 ? f.x : 1.0 - f.x) * (d.y == 1 ? f.y : 1.0 - f.y) * residual.a * cos_v * cos_v;
        if (how == BEYOND) w *= u_beyond;
        o_update += vec4(residual.rgb * w, w);
    }
    if (o_update.a <= 0.0) discard;
}
