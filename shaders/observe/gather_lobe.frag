// The geometry of one light's lobe, copied from the pixels matched to the texels.
uniform sampler2D u_match;
uniform sampler2D u_lobe;
uniform int u_row;

layout(location = 0) out vec4 o_lobe;

void main() {
    vec4 match = texelFetch(u_match, ivec2(gl_FragCoord.xy) - ivec2(0, u_row), 0);
    o_lobe = match.w <= 0.0 ? vec4(0.0) : texelFetch(u_lobe, ivec2(match.xy), 0);
}
