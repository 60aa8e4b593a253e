// Pull: the weighted mean of four texels (Gortler et al. 1996, push-pull).
uniform sampler2D u_map;  // value, weight in a

layout(location = 0) out vec4 o_map;

void main() {
    ivec2 at = 2 * ivec2(gl_FragCoord.xy), last = textureSize(u_map, 0) - 1;
    vec4 sum = vec4(0.0);
    for (int j = 0; j < 4; j++) {
        ivec2 texel = at + ivec2(j & 1, j >> 1);
        if (any(greaterThan(texel, last))) continue;
        vec4 m = texelFetch(u_map, texel, 0);
        sum += vec4(m.rgb * m.a, m.a);
    }
    o_map = sum.a > 0.0 ? vec4(sum.rgb / sum.a, min(sum.a, 1.0)) : vec4(0.0);
}
