// Share of one light that reaches each pixel of a camera; of a light with several points, what one of them sends there.
#include "include/shadow.glsl"
uniform sampler2D u_position;  // pixel grid: world xyz, coverage
uniform sampler2D u_normal;
uniform sampler2D u_facet;
uniform sampler2D u_shadow;    // linear depth, nearest
uniform mat4 u_shadow_clip;
uniform vec4 u_depth_plane;    // linear depth = dot(plane, (P, 1))
uniform float u_texel;         // width of a shadow texel: metres (parallel) or metres per metre of depth
uniform bool u_parallel;
uniform float u_share;         // how much of the light the point sends to what faces it

uniform int u_face;            // which of the light's six maps this is; -1: the only one
uniform vec3 u_origin;         // of a perspective map

#ifdef SEVERAL
layout(location = 0) out vec2 o_lit;  // what arrives, and what would arrive if nothing were in the way
#else
layout(location = 0) out float o_lit;
#endif

// The map that sees a direction: by its longest component, so that each point has just one.
int face_of(vec3 d) {
    vec3 a = abs(d);
    int axis = a.x >= a.y && a.x >= a.z ? 0 : (a.y >= a.z ? 1 : 2);
    return d[axis] >= 0.0 ? axis : axis + 3;
}

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec4 p = texelFetch(u_position, pixel, 0);
    if (p.w < 0.5) discard;
    vec4 facet = texelFetch(u_facet, pixel, 0);
    vec3 n = texelFetch(u_normal, pixel, 0).xyz;

    // The point is lifted to the smooth surface that the normals describe, so that facets near the
    // terminator do not shadow it.
    float texel = u_parallel ? u_texel : u_texel * distance(p.xyz, u_origin);
    vec3 toward = u_parallel ? -u_depth_plane.xyz : normalize(u_origin - p.xyz);
    vec3 lifted = p.xyz + n * rise(facet, toward) + facet.xyz * LIFT * texel;
    if (u_face >= 0 && face_of(lifted - u_origin) != u_face) discard;
    vec4 clip = u_shadow_clip * vec4(lifted, 1.0);
    if (clip.w <= 0.0) discard;
    vec2 at = clip.xy / clip.w;
    if (u_face >= 0 && any(greaterThan(abs(at), vec2(1.0)))) discard;

    float depth = dot(u_depth_plane, vec4(lifted, 1.0));
    vec3 ray = u_parallel ? u_depth_plane.xyz : (lifted - u_origin) / depth;
    mat4 rows = transpose(u_shadow_clip);
    vec2 slope = depth_slope(facet.xyz, ray, normalize(rows[0].xyz), normalize(rows[1].xyz), texel);
    int side = textureSize(u_shadow, 0).x;
    float lit = lit_in(u_shadow, ivec2(0), side, (at * 0.5 + 0.5) * float(side) - 0.5, depth - BIAS * texel, slope);
#ifdef SEVERAL
    // A point below the horizon sends nothing, so that nothing is missing where the shadow map does not show it.
    o_lit = u_share * max(dot(n, toward), 0.0) * vec2(lit, 1.0);
#else
    o_lit = lit;
#endif
}
