// What solve/fit_two.glsl says of a texel at the roughnesses and the weight given.
#include "solve/fit_two.glsl"
uniform sampler2D u_at;  // roughness1, roughness2, weight
// out_0: residual, gradient, weight.  out_1: curvature

void kernel() {
    out_0 = out_1 = vec4(0.0);
    if (!load_observations()) return;
    vec4 at = texelFetch(u_at, texel_here(), 0);
    FitTwo fit = evaluate(at.xy, at.z);
    out_0 = vec4(fit.residual, fit.gradient, fit.weight);
    out_1.xyz = fit.curvature;
}
