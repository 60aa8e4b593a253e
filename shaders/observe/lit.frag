// Share of one light (or of one of its sample points) that reaches each pixel of a camera:
// shadow mapping (Williams 1978) with bilinear percentage-closer filtering (Reeves et al. 1987).
uniform sampler2D u_position;  // pixel grid: world xyz, coverage
uniform sampler2D u_normal;
uniform sampler2D u_facet;
uniform sampler2D u_shadow;    // linear depth, nearest
uniform mat4 u_shadow_clip;
uniform vec4 u_depth_plane;    // linear depth = dot(plane, (P, 1))
uniform float u_texel;         // width of a shadow texel: metres (parallel) or metres per metre of depth
uniform bool u_parallel;
uniform float u_share;         // 1 / number of sample points

uniform int u_face;            // which of the light's six maps this is; -1: the only one
uniform vec3 u_origin;         // of a perspective map

layout(location = 0) out float o_lit;

// The map that sees a direction: by its longest component, so that each point has just one.
int face_of(vec3 d) {
    vec3 a = abs(d);
    int axis = a.x >= a.y && a.x >= a.z ? 0 : (a.y >= a.z ? 1 : 2);
    return d[axis] >= 0.0 ? axis : axis + 3;
}

float tap(ivec2 at, float depth) {
    ivec2 size = textureSize(u_shadow, 0);
    return texelFetch(u_shadow, clamp(at, ivec2(0), size - 1), 0).r < depth ? 0.0 : 1.0;
}

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec4 p = texelFetch(u_position, pixel, 0);
    if (p.w < 0.5) discard;
    vec4 facet = texelFetch(u_facet, pixel, 0);
    vec3 n = texelFetch(u_normal, pixel, 0).xyz;

    // The point is lifted to the smooth surface that the normals describe, so that facets near the
    // terminator do not shadow it, and by two shadow texels along the facet's normal.
    float texel = u_parallel ? u_texel : u_texel * distance(p.xyz, u_origin);
    vec3 lifted = p.xyz + n * facet.w + facet.xyz * 2.0 * texel;
    if (u_face >= 0 && face_of(lifted - u_origin) != u_face) discard;
    vec4 clip = u_shadow_clip * vec4(lifted, 1.0);
    if (clip.w <= 0.0) discard;
    vec2 at = clip.xy / clip.w;
    if (u_face >= 0 && any(greaterThan(abs(at), vec2(1.0)))) discard;

    float receiver = dot(u_depth_plane, vec4(lifted, 1.0)) - texel;
    vec2 where = (at * 0.5 + 0.5) * vec2(textureSize(u_shadow, 0)) - 0.5;
    ivec2 corner = ivec2(floor(where));
    vec2 f = where - vec2(corner);
    float lit = mix(mix(tap(corner, receiver), tap(corner + ivec2(1, 0), receiver), f.x),
                    mix(tap(corner + ivec2(0, 1), receiver), tap(corner + ivec2(1, 1), receiver), f.x), f.y);
    o_lit = lit * u_share;
}
