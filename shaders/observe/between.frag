// What a view shows where places lie in its picture: between the centres of the four pixels around each.
#include "include/pixel.glsl"
uniform sampler2D u_place;         // world xyz, coverage
uniform sampler2D u_place_normal;
uniform sampler2D u_colour;        // as of observe/colour.frag

layout(location = 0) out vec4 o_shown;  // radiance / irradiance (1/sr), 1; 0 where it is not known

void main() {
    ivec2 cell = ivec2(gl_FragCoord.xy);
    o_shown = vec4(0.0);
    vec4 p = texelFetch(u_place, cell, 0);
    vec4 clip = clip_of(p.xyz);
    if (p.w < 0.5 || clip.w <= 0.0) return;
    float cos_v = dot(texelFetch(u_place_normal, cell, 0).xyz, toward_camera(p.xyz));
    vec2 at = (clip.xy / clip.w * 0.5 + 0.5) * vec2(textureSize(u_position, 0)) - 0.5;
    ivec2 corner = ivec2(floor(at));
    bool inside = all(greaterThanEqual(corner, ivec2(0))) && all(lessThan(corner + 1, textureSize(u_position, 0)));
    if (cos_v < LEAST_COSINE || !inside) return;
    vec2 share = at - vec2(corner);
    vec3 shown = vec3(0.0);
    for (int j = 0; j < 4; j++) {
        ivec2 step = ivec2(j & 1, j >> 1);
        vec4 colour = texelFetch(u_colour, corner + step, 0);
        bool seen = same_surface(p, texelFetch(u_position, corner + step, 0), cos_v, 1.0);
        if (!seen || colour.a < LEAST_QUALITY * cos_v * cos_v) return;
        vec2 weight = mix(1.0 - share, share, vec2(step));
        shown += weight.x * weight.y * colour.rgb;
    }
    o_shown = vec4(shown, 1.0);
}
