// One step of the texture towards what the pixels show.  A texel that only edge pixels show is known
// in part: filling then mixes it with its neighbours.
uniform sampler2D u_texture;  // RGB, how far known
uniform sampler2D u_update;   // weighted residual sum, weight
uniform bool u_from_black;    // start anew
uniform float u_slack;        // weight that holds a step back where little is known

layout(location = 0) out vec4 o_texture;

void main() {
    ivec2 texel = ivec2(gl_FragCoord.xy);
    vec4 now = texelFetch(u_texture, texel, 0), update = texelFetch(u_update, texel, 0);
    const float ENOUGH = 0.1;  // weight from which on a texel is wholly known
    o_texture = update.a > 0.0
        ? vec4(clamp((u_from_black ? vec3(0.0) : now.rgb) + update.rgb / (update.a + u_slack), 0.0, 1.0), max(now.a, min(update.a / ENOUGH, 1.0)))
        : now;
}
