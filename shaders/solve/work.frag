// About how many observations the texels of a square of the atlas have, and one more for each texel: what a kernel's
// time depends on.  Looks at one texel in sixteen.
uniform sampler2D u_observations;
uniform int u_tile_height;

layout(location = 0) out float o_work;

void main() {
    ivec2 first = CELL * ivec2(gl_FragCoord.xy), last = ivec2(textureSize(u_observations, 0).x, u_tile_height) - 1;
    int seen = 0;
    for (int j = 0; j < 4; j++) {
        ivec2 at = min(first + 1 + 4 * ivec2(j & 1, j >> 1), last);
        for (int n = 0; n < LAYERS; n++)
            if (texelFetch(u_observations, at + ivec2(0, n * BLOCKS * u_tile_height), 0).y > 0.0) seen++;
    }
    o_work = float(CELL * CELL) * (1.0 + 0.25 * float(seen));
}
