// How much of one operation this device does in a shader: sixteen chains that do not wait for each other, unrolled.
// Define OPERATION(a): what one link of a chain does; x and y are known at run time only.
#include "include/kernel.glsl"
uniform int u_steps;  // 64 operations each
uniform float u_x;
uniform float u_y;
uniform sampler2D u_map;

void kernel() {
    float x = u_x, y = u_y;
    vec4 a = vec4(texel_here(), 1.0, 2.0) * 1e-4, b = a + 0.1, c = a + 0.2, d = a + 0.3;
#define LINK(v) v = vec4(OPERATION(v.x), OPERATION(v.y), OPERATION(v.z), OPERATION(v.w));
    for (int i = 0; i < u_steps; i++) {
        LINK(a) LINK(b) LINK(c) LINK(d)
        LINK(a) LINK(b) LINK(c) LINK(d)
        LINK(a) LINK(b) LINK(c) LINK(d)
        LINK(a) LINK(b) LINK(c) LINK(d)
    }
    out_0 = a + b + c + d;
}
