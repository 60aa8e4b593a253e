// A texture as it is, elsewhere in another.
uniform sampler2D u_map;
uniform ivec2 u_corner;

layout(location = 0) out vec4 o_map;

void main() {
    o_map = texelFetch(u_map, ivec2(gl_FragCoord.xy) - u_corner, 0);
}
