// Plain arithmetic: twelve independent chains of multiply-adds, to time a device by.
#include "include/kernel.glsl"
uniform int u_steps;  // 24 multiply-adds each

void kernel() {
    vec4 a = vec4(texel_here(), 1.0, 2.0) * 1e-4, b = a + 0.1, c = a + 0.2;
    for (int i = 0; i < u_steps; i++) {
        a = a * 0.999 + 0.001; b = b * 0.998 + 0.002; c = c * 0.997 + 0.003;
        a = a * 0.999 + 0.001; b = b * 0.998 + 0.002; c = c * 0.997 + 0.003;
    }
    out_0 = a + b + c;
}
