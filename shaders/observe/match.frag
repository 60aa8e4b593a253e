// Which pixel of a camera shows a texel: the nearest of the four around its projection that sees
// the same stretch of surface.  The pixel's own geometry is then used with the pixel's own colour.
#include "include/pixel.glsl"
uniform sampler2D u_texel_position;
uniform sampler2D u_texel_normal;
uniform float u_reach; // texels: a pixel so far from a texel counts half
uniform ivec2 u_tile;  // first texel of the tile

layout(location = 0) out vec4 o_match;  // pixel x, pixel y, cos_v there, how well it stands for the texel (0: not)

// Width of a texel on the surface, metres: the shortest step to a covered neighbour.
float texel_width(ivec2 texel, vec3 p) {
    float width = 1e30;
    for (int j = 0; j < 4; j++) {
        ivec2 step = j < 2 ? ivec2(2 * j - 1, 0) : ivec2(0, 2 * j - 5);
        ivec2 near = clamp(texel + step, ivec2(0), textureSize(u_texel_position, 0) - 1);
        vec4 q = texelFetch(u_texel_position, near, 0);
        if (near != texel && q.w > 0.5) width = min(width, distance(p, q.xyz));
    }
    return max(width, 1e-9);
}

void main() {
    ivec2 texel = u_tile + ivec2(gl_FragCoord.xy);
    o_match = vec4(0.0);
    if (any(greaterThanEqual(texel, textureSize(u_texel_position, 0)))) return;
    vec4 p = texelFetch(u_texel_position, texel, 0);
    vec4 clip = clip_of(p.xyz);
    if (p.w < 0.5 || clip.w <= 0.0) return;
    vec2 at = (clip.xy / clip.w * 0.5 + 0.5) * vec2(textureSize(u_position, 0));
    vec3 n = texelFetch(u_texel_normal, texel, 0).xyz;
    float cos_v = dot(n, toward_camera(p.xyz));
    if (cos_v <= 0.0) return;  // the pixel shows what hides it
    float slant = clamp(cos_v, 0.15, 1.0);
    ivec2 corner = ivec2(floor(at - 0.5));
    float nearest = 1e30;
    vec2 best;
    vec3 there, normal;  // position and normal at the nearest
    for (int j = 0; j < 4; j++) {
        ivec2 pixel = corner + ivec2(j & 1, j >> 1);
        if (any(lessThan(pixel, ivec2(0))) || any(greaterThanEqual(pixel, textureSize(u_position, 0)))) continue;
        vec4 seen = texelFetch(u_position, pixel, 0);
        if (!same_surface(p, seen, slant, 1.0)) continue;
        vec3 seen_normal = texelFetch(u_normal, pixel, 0).xyz;
        if (dot(seen_normal, n) < 0.5) continue;  // round a sharp corner
        float far = distance(at, vec2(pixel) + 0.5);
        if (far < nearest) {
            nearest = far;
            best = vec2(pixel);
            there = seen.xyz;
            normal = seen_normal;
        }
    }
    if (nearest > 1e29) return;
    // A pixel seen at a grazing angle may show a place texels away, where the material differs.
    float texels = distance(there, p.xyz) / (u_reach * texel_width(texel, p.xyz));
    o_match = vec4(best, dot(normal, toward_camera(there)), 1.0 / (1.0 + texels * texels));
}
