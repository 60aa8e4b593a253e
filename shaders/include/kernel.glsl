// A kernel runs once for each texel of a region, as a fragment or as a compute shader from the same text.
// The file that includes this defines `void kernel()`, which writes out_0 to out_{OUTPUTS - 1}.
#ifdef COMPUTE
layout(local_size_x = WORKGROUP, local_size_y = WORKGROUP) in;
uniform ivec4 u_region;  // first texel, width, height
layout(rgba32f, binding = 0) writeonly uniform image2D u_out_0;
vec4 out_0;
#if OUTPUTS > 1
layout(rgba32f, binding = 1) writeonly uniform image2D u_out_1;
vec4 out_1;
#endif
#if OUTPUTS > 2
layout(rgba32f, binding = 2) writeonly uniform image2D u_out_2;
vec4 out_2;
#endif
#if OUTPUTS > 3
layout(rgba32f, binding = 3) writeonly uniform image2D u_out_3;
vec4 out_3;
#endif
#if OUTPUTS > 4
layout(rgba32f, binding = 4) writeonly uniform image2D u_out_4;
vec4 out_4;
#endif
#if OUTPUTS > 5
layout(rgba32f, binding = 5) writeonly uniform image2D u_out_5;
vec4 out_5;
#endif
#if OUTPUTS > 6
layout(rgba32f, binding = 6) writeonly uniform image2D u_out_6;
vec4 out_6;
#endif
#if OUTPUTS > 7
layout(rgba32f, binding = 7) writeonly uniform image2D u_out_7;
vec4 out_7;
#endif

ivec2 texel_here() { return u_region.xy + ivec2(gl_GlobalInvocationID.xy); }

void kernel();

void main() {
    if (any(greaterThanEqual(ivec2(gl_GlobalInvocationID.xy), u_region.zw))) return;
    kernel();
    imageStore(u_out_0, texel_here(), out_0);
#if OUTPUTS > 1
    imageStore(u_out_1, texel_here(), out_1);
#endif
#if OUTPUTS > 2
    imageStore(u_out_2, texel_here(), out_2);
#endif
#if OUTPUTS > 3
    imageStore(u_out_3, texel_here(), out_3);
#endif
#if OUTPUTS > 4
    imageStore(u_out_4, texel_here(), out_4);
#endif
#if OUTPUTS > 5
    imageStore(u_out_5, texel_here(), out_5);
#endif
#if OUTPUTS > 6
    imageStore(u_out_6, texel_here(), out_6);
#endif
#if OUTPUTS > 7
    imageStore(u_out_7, texel_here(), out_7);
#endif
}
#else
layout(location = 0) out vec4 out_0;
#if OUTPUTS > 1
layout(location = 1) out vec4 out_1;
#endif
#if OUTPUTS > 2
layout(location = 2) out vec4 out_2;
#endif
#if OUTPUTS > 3
layout(location = 3) out vec4 out_3;
#endif
#if OUTPUTS > 4
layout(location = 4) out vec4 out_4;
#endif
#if OUTPUTS > 5
layout(location = 5) out vec4 out_5;
#endif
#if OUTPUTS > 6
layout(location = 6) out vec4 out_6;
#endif
#if OUTPUTS > 7
layout(location = 7) out vec4 out_7;
#endif

ivec2 texel_here() { return ivec2(gl_FragCoord.xy); }

void kernel();

void main() { kernel(); }
#endif
