// Which pixel of a camera shows a texel: the nearest of the four around its projection that sees
// the same stretch of surface.  The pixel's own geometry is then used with the pixel's own colour.
#include "include/pixel.glsl"
uniform sampler2D u_texel_position;
uniform sampler2D u_texel_normal;
uniform mat4 u_clip;
uniform ivec2 u_tile;  // first texel of the tile

layout(location = 0) out vec4 o_match;  // pixel x, pixel y, cos_v there, 1 where matched

void main() {
    ivec2 texel = u_tile + ivec2(gl_FragCoord.xy);
    o_match = vec4(0.0);
    if (any(greaterThanEqual(texel, textureSize(u_texel_position, 0)))) return;
    vec4 p = texelFetch(u_texel_position, texel, 0);
    vec4 clip = u_clip * vec4(p.xyz, 1.0);
    if (p.w < 0.5 || clip.w <= 0.0) return;
    vec2 at = (clip.xy / clip.w * 0.5 + 0.5) * vec2(textureSize(u_position, 0));
    vec3 n = texelFetch(u_texel_normal, texel, 0).xyz;
    float slant = clamp(dot(n, toward_camera(p.xyz)), 0.15, 1.0);
    ivec2 corner = ivec2(floor(at - 0.5));
    float nearest = 1e30;
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
            o_match = vec4(vec2(pixel), dot(seen_normal, toward_camera(seen.xyz)), 1.0);
        }
    }
}
