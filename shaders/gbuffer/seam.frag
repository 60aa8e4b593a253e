// Added to positions: less coverage where a corner of the pixel shows other than its centre.
uniform sampler2D u_told;  // see gbuffer/told.frag

layout(location = 0) out vec4 o_position;

void main() {
    float told = texelFetch(u_told, ivec2(gl_FragCoord.xy), 0).r;
    o_position = vec4(0.0, 0.0, 0.0, told > 0.5 ? 0.0 : -SEAM);
}
