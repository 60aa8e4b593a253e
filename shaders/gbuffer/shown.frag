// A camera's positions, of the pixels alone that show the part to solve, and of those around them: an outline drawn
// close about the part would look like the object's own.
uniform sampler2D u_position;
uniform sampler2D u_uv;
uniform sampler2D u_part;  // texel grid: share of the new result

layout(location = 0) out vec4 o_position;

const int REACH = 3;  // pixels

bool in_part(ivec2 pixel) {
    if (texelFetch(u_position, pixel, 0).w < 0.5) return false;
    ivec2 size = textureSize(u_part, 0), texel = ivec2(floor(texelFetch(u_uv, pixel, 0).xy * vec2(size)));
    return all(greaterThanEqual(texel, ivec2(0))) && all(lessThan(texel, size)) && texelFetch(u_part, texel, 0).r > 0.0;
}

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy), last = textureSize(u_position, 0) - 1;
    o_position = vec4(0.0);
    vec4 p = texelFetch(u_position, at, 0);
    if (p.w < 0.5) return;
    for (int y = -REACH; y <= REACH; y++) for (int x = -REACH; x <= REACH; x++)
        if (in_part(clamp(at + ivec2(x, y), ivec2(0), last))) o_position = p;
}
