// Cells of the pyramid. Each holds up to two kinds of texels, which differ in base colour, and a residual table of
// each.
#ifdef TEXELS  // the finest cells: of one kind
const int KINDS = 1;
uniform sampler2D u_table[8];
uniform sampler2D u_colour;  // base colour, 1 where observed

ivec2 cell_count() { return textureSize(u_colour, 0); }

vec4 cell_colour(ivec2 cell, int kind) {
    vec4 colour = texelFetch(u_colour, cell, 0);
    return vec4(sqrt(colour.rgb), colour.a);
}

vec4 cell_table(ivec2 cell, int kind, int i) {
    if (i == 0) return texelFetch(u_table[0], cell, 0);
    if (i == 1) return texelFetch(u_table[1], cell, 0);
    if (i == 2) return texelFetch(u_table[2], cell, 0);
    if (i == 3) return texelFetch(u_table[3], cell, 0);
    if (i == 4) return texelFetch(u_table[4], cell, 0);
    if (i == 5) return texelFetch(u_table[5], cell, 0);
    if (i == 6) return texelFetch(u_table[6], cell, 0);
    return texelFetch(u_table[7], cell, 0);
}
#else
const int KINDS = 2;
uniform sampler2D u_table;  // the eight of each kind side by side in two rows of four, those of the second kind above
uniform sampler2D u_colour[2];  // of each kind: square root of base colour, how many texels

ivec2 cell_count() { return textureSize(u_table, 0) / 4; }

vec4 cell_colour(ivec2 cell, int kind) {
    return kind == 0 ? texelFetch(u_colour[0], cell, 0) : texelFetch(u_colour[1], cell, 0);
}

vec4 cell_table(ivec2 cell, int kind, int i) {
    return texelFetch(u_table, cell + ivec2(i & 3, 2 * kind + (i >> 2)) * cell_count(), 0);
}
#endif

float squared(vec3 v) { return dot(v, v); }
