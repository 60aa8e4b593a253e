// What surrounds a pixel, for all of its camera's views: a bit for each of the 3 x 3 pixels around it that shows the
// mesh, and SILHOUETTE where one of them shows another stretch of surface, or none.
#include "include/pixel.glsl"

layout(location = 0) out float o_rim;

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy), last = textureSize(u_position, 0) - 1;
    vec4 p = texelFetch(u_position, at, 0);
    if (p.w < 0.5) discard;
    float slant = max(dot(texelFetch(u_normal, at, 0).xyz, toward_camera(p.xyz)), 0.15);
    bool ends = false;
    o_rim = 0.0;
    for (int j = 0; j < 9; j++) {
        vec4 near = texelFetch(u_position, clamp(at + ivec2(j % 3, j / 3) - 1, ivec2(0), last), 0);
        ends = ends || !same_surface(p, near, slant, 1.5);
        o_rim += near.w < 0.5 ? 0.0 : float(1 << j);
    }
    if (ends && u_footprint > 0.25) o_rim += float(SILHOUETTE);  // a point sample mixes nothing with its neighbours
}
