// What solve/fit.glsl says of a texel at the roughness and under the noise given, outliers disbelieved.
#include "solve/fit.glsl"
uniform sampler2D u_at;  // roughness, variance of the noise
// out_0: residual, gradient, curvature, squares alone.  out_1: outliers, good observations

void kernel() {
    out_0 = out_1 = vec4(0.0);
    if (!load_observations()) return;
    vec4 at = texelFetch(u_at, texel_here(), 0);
    obs_variance = at.y;
    out_0.xyz = evaluate(at.x);
    out_0.w = fit_squares;
    out_1.xy = vec2(fit_outliers, obs_total);
}
