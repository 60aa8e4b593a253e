// What solve/fit.glsl says of a texel at the roughness given.
#include "solve/fit.glsl"
uniform sampler2D u_at;  // roughness
// out_0: residual, gradient, curvature, residual without lobe.  out_1: albedo's slope and variance, good observations

void kernel() {
    out_0 = out_1 = vec4(0.0);
    if (!load_observations()) return;
    out_0.xyz = evaluate(texelFetch(u_at, texel_here(), 0).x);
    out_1.xy = fit_albedo();
    out_0.w = evaluate_lambert();
    out_1.z = obs_total;
}
