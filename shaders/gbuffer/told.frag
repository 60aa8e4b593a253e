// 1 where a place in a pixel, so far from its centre, shows what the centre's slopes tell of it; else 0.
in vec2 v_grid;
uniform sampler2D u_uv;        // of the pixels' centres
uniform sampler2D u_uv_slope;
uniform vec2 u_away;           // pixels

layout(location = 0) out float o_told;

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec4 slope = texelFetch(u_uv_slope, at, 0);
    vec2 told = texelFetch(u_uv, at, 0).xy + u_away.x * slope.xy + u_away.y * slope.zw;
    o_told = all(lessThanEqual(abs(v_grid - told), abs(slope.xy) + abs(slope.zw))) ? 1.0 : 0.0;
}
