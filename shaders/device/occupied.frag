// Does a square of CELL x CELL pixels hold anything?
uniform sampler2D u_map;

layout(location = 0) out float o_occupied;

void main() {
    ivec2 first = CELL * ivec2(gl_FragCoord.xy), size = textureSize(u_map, 0);
    o_occupied = 0.0;
    for (int y = first.y; y < min(first.y + CELL, size.y); y++) for (int x = first.x; x < min(first.x + CELL, size.x); x++)
        o_occupied = max(o_occupied, texelFetch(u_map, ivec2(x, y), 0).a != 0.0 ? 1.0 : 0.0);
}
