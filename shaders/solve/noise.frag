// Logarithm of the noise variance that a texel's best fit leaves: its mean over a neighbourhood is
// robust against texels whose fit fails.
uniform sampler2D u_valleys;
uniform sampler2D u_support;

layout(location = 0) out vec4 o_noise;  // log variance, -, -, weight

void main() {
    ivec2 texel = ivec2(gl_FragCoord.xy);
#if LOBES == 2
    float residual = texelFetch(u_valleys, texel, 0).w;
#else
    float residual = texelFetch(u_valleys, texel, 0).y;
#endif
    vec4 support = texelFetch(u_support, texel, 0);
    // A residual of a few degrees of freedom is far below its variance as often as above it.
    float weight = support.w * clamp((support.z - 1.0) / 4.0, 0.0, 1.0);
    o_noise = vec4(log(max(residual / max(support.z, 1e-6), 1e-12)), 0.0, 0.0, weight);
}
