// One step of the texture towards what the pixels show.
uniform sampler2D u_texture;  // RGB, known
uniform sampler2D u_update;   // weighted residual sum, weight
uniform float u_step;

layout(location = 0) out vec4 o_texture;

void main() {
    ivec2 texel = ivec2(gl_FragCoord.xy);
    vec4 now = texelFetch(u_texture, texel, 0), update = texelFetch(u_update, texel, 0);
    o_texture = update.a > 0.0 ? vec4(clamp(now.rgb + u_step * update.rgb / update.a, 0.0, 1.0), 1.0) : now;
}
