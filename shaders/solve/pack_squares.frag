// Squares of a grid of texels side by side, as `Squares.pack` in irpso_addon/gpu/solve/material_sample.py does to arrays.
uniform sampler2D u_grid;
uniform sampler2D u_corners;  // first texel of each square, one pixel each
uniform int u_side;  // texels: width of a square
uniform int u_columns;  // squares side by side

layout(location = 0) out vec4 o_texel;

void main() {
    ivec2 here = ivec2(gl_FragCoord.xy), square = here / u_side;
    int n = square.y * u_columns + square.x;
    bool known = square.x < u_columns && n < textureSize(u_corners, 0).x;
    ivec2 texel = ivec2(texelFetch(u_corners, ivec2(known ? n : 0, 0), 0).xy) + here % u_side;
    o_texel = known && all(lessThan(texel, textureSize(u_grid, 0))) ? texelFetch(u_grid, texel, 0) : vec4(0.0);
}
