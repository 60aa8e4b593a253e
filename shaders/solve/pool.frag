// One level up the pyramid of residual tables: what four cells say together.
uniform sampler2D u_table[8];
uniform float u_gain;  // below 1 at the first level, where texels that share a pixel repeat each other

layout(location = 0) out vec4 o_table[8];

vec4 pooled(sampler2D table) {
    ivec2 at = 2 * ivec2(gl_FragCoord.xy), last = textureSize(table, 0) - 1;
    vec4 sum = vec4(0.0);
    for (int j = 0; j < 4; j++) {
        ivec2 cell = at + ivec2(j & 1, j >> 1);
        if (all(lessThanEqual(cell, last))) sum += texelFetch(table, cell, 0);
    }
    return u_gain * sum;
}

void main() {
    o_table[0] = pooled(u_table[0]);
    o_table[1] = pooled(u_table[1]);
    o_table[2] = pooled(u_table[2]);
    o_table[3] = pooled(u_table[3]);
    o_table[4] = pooled(u_table[4]);
    o_table[5] = pooled(u_table[5]);
    o_table[6] = pooled(u_table[6]);
    o_table[7] = pooled(u_table[7]);
}
