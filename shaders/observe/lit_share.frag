// Share of a light with several points that reaches each pixel, from the sums of observe/lit.frag.
uniform sampler2D u_sums;

layout(location = 0) out float o_lit;

void main() {
    vec2 sums = texelFetch(u_sums, ivec2(gl_FragCoord.xy), 0).rg;
    // Where all points are below the horizon, all that arrives of the rest of the light does.
    o_lit = sums.g > 0.0 ? sums.r / sums.g : 1.0;
}
