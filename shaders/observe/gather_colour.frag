// The texels' observations of one view: copied from the pixels matched to them.
uniform sampler2D u_match;
uniform sampler2D u_colour;
uniform int u_channel;  // 0, 1, 2; -1: the mean of the three; 3: the three as they are, nothing else
uniform float u_tint;   // light in the channel, relative to the mean of the three
uniform int u_row;      // first row of this layer in the atlas

layout(location = 0) out vec4 o_observation;  // f (1/sr), quality, cos_v, 2 channel + edge + match / 2

void main() {
    vec4 match = texelFetch(u_match, ivec2(gl_FragCoord.xy) - ivec2(0, u_row), 0);
    o_observation = vec4(0.0);
    if (match.w <= 0.0) return;
    vec4 colour = texelFetch(u_colour, ivec2(match.xy), 0);
    if (u_channel == 3) {
        o_observation = vec4(mix(colour.rgb, vec3(0.0), lessThan(colour.rgb, vec3(UNLIT_BELOW))), 0.0);  // 0: no light in it
        return;
    }
    if (colour.a <= 0.0) colour = vec4(0.0);  // a clipped pixel is no observation
    float f = u_channel < 0 ? (colour.r + colour.g + colour.b) / 3.0 : colour[u_channel];
    if (f < UNLIT_BELOW) return;  // no light in this channel
    float dim = min(u_tint, 1.0);  // the camera's own noise counts for more where there is little light
    float cos_v = clamp(match.z, 1e-3, 1.0);
    bool edge = colour.a < EDGE_QUALITY * cos_v * cos_v;  // cos_v^2 is what a good pixel has
    o_observation = vec4(f, colour.a * dim * dim * match.w, cos_v, 2.0 * float(max(u_channel, 0)) + (edge ? 1.0 : 0.0) + 0.5 * match.w);
}
