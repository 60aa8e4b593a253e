// One level up the pyramid of residual tables: what the members of each kind, as solve/kinds.frag found them, say
// together.
#include "solve/cells.glsl"
uniform sampler2D u_members;
uniform float u_gain;  // below 1 as far as their errors are alike

layout(location = 0) out vec4 o_table;

void main() {
    ivec2 size = textureSize(u_members, 0), pixel = ivec2(gl_FragCoord.xy);
    ivec2 tile = pixel / size, at = pixel - tile * size;
    vec4 both = texelFetch(u_members, at, 0);
    int members = int(tile.y < 2 ? both.x : both.y);
    vec4 sum = vec4(0.0);
    for (int n = 0; n < 8; n++) {
        if (((members >> n) & 1) == 0) continue;
        sum += cell_table(2 * at + ivec2((n >> 1) & 1, n >> 2), n & 1, tile.x + 4 * (tile.y & 1));
    }
    o_table = u_gain * sum;
}
