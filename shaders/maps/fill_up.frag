// Push: where a texel has no value of its own, its parents' interpolated one.  BORDER: or that of the texels beside it, which
// a renderer mixes with it at the border of a UV island.
uniform sampler2D u_map;
uniform sampler2D u_parent;  // filled already

layout(location = 0) out vec4 o_map;

#ifdef BORDER
// What the four texels around know, else the four at the corners; where these know little, mixed with the parents.
vec3 beside(ivec2 texel, vec3 parent) {
    ivec2 last = textureSize(u_map, 0) - 1;
    for (int turned = 0; turned < 2; turned++) {
        vec4 sum = vec4(0.0);
        for (int j = 0; j < 4; j++) {
            ivec2 d = turned == 1 ? 2 * ivec2(j & 1, j >> 1) - 1 : (j < 2 ? ivec2(2 * j - 1, 0) : ivec2(0, 2 * j - 5));
            vec4 m = texelFetch(u_map, clamp(texel + d, ivec2(0), last), 0);
            sum += m.a * vec4(m.rgb, 1.0);
        }
        if (sum.a > 0.0) return mix(parent, sum.rgb / sum.a, min(sum.a, 1.0));
    }
    return parent;
}
#endif

void main() {
    ivec2 texel = ivec2(gl_FragCoord.xy);
    vec4 own = texelFetch(u_map, texel, 0);
    vec2 at = 0.5 * gl_FragCoord.xy - 0.5;
    ivec2 corner = ivec2(floor(at)), last = textureSize(u_parent, 0) - 1;
    vec2 f = at - vec2(corner);
    vec3 parent = vec3(0.0);
    for (int j = 0; j < 4; j++) {
        ivec2 d = ivec2(j & 1, j >> 1);
        parent += (d.x == 1 ? f.x : 1.0 - f.x) * (d.y == 1 ? f.y : 1.0 - f.y)
                * texelFetch(u_parent, clamp(corner + d, ivec2(0), last), 0).rgb;
    }
#ifdef BORDER
    if (own.a < 1.0) parent = beside(texel, parent);
#endif
    o_map = vec4(mix(parent, own.rgb, own.a), 1.0);
}
