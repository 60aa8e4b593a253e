// Logarithm of the noise variance that a texel's best fit leaves: its mean over a neighbourhood is
// robust against texels whose fit fails.
uniform sampler2D u_valleys;
uniform sampler2D u_support;
uniform bool u_few;  // degrees of freedom, 1 or less, in all texels

layout(location = 0) out vec4 o_noise;  // log variance, -, -, weight

// By how much the mean logarithm of a chi-squared variable over its 2 x degrees of freedom lies below 0: log x less the
// digamma function (Abramowitz and Stegun 1964, 6.3.5 and 6.3.18).
float below(float x) {
    float next = x + 1.0;
    return log(x) + 1.0 / x - log(next) + 0.5 / next + 1.0 / (12.0 * next * next);
}

void main() {
    ivec2 texel = ivec2(gl_FragCoord.xy);
#if LOBES == 2
    float residual = texelFetch(u_valleys, texel, 0).w;
#else
    float residual = texelFetch(u_valleys, texel, 0).y;
#endif
    vec4 support = texelFetch(u_support, texel, 0);
    // A residual of a few degrees of freedom is far below its variance as often as above it.
    float weight = min(support.w, 1.0) * clamp(u_few ? support.z : (support.z - 1.0) / 4.0, 0.0, 1.0);
    float value = log(max(residual / max(support.z, 1e-6), 1e-12));
    if (u_few) value += below(0.5 * max(support.z, 0.1));
    o_noise = vec4(value, 0.0, 0.0, weight);
}
