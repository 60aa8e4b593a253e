// Push: where a texel has no value of its own, its parents' interpolated one.
uniform sampler2D u_map;
uniform sampler2D u_parent;  // filled already

layout(location = 0) out vec4 o_map;

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
    o_map = vec4(mix(parent, own.rgb, own.a), 1.0);
}
