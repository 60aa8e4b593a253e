// Irradiance of an environment as that of a view's lights: whether an edge of a shadow passes here.
uniform sampler2D u_sums;  // as observe/environment.frag leaves it

const float EDGE_SHARE = 0.1;  // of the light that comes from where the edge of its shadow is

layout(location = 0) out vec4 o_irradiance;  // RGB, shadow edge (> 0)

void main() {
    vec4 sums = texelFetch(u_sums, ivec2(gl_FragCoord.xy), 0);
    o_irradiance = vec4(sums.rgb, sums.a > EDGE_SHARE * dot(sums.rgb, vec3(1.0 / 3.0)) ? 1.0 : 0.0);
}
