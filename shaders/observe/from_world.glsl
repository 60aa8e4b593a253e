// An environment's directions, from far away.
uniform sampler2D u_directions;  // two texels each: toward, spread; power, 0.  A level's parts follow all of the level

Direction direction(int n) {
    vec4 a = texelFetch(u_directions, texel_of(2 * n), 0), b = texelFetch(u_directions, texel_of(2 * n + 1), 0);
    return Direction(a.xyz, a.w, b.rgb);
}

// Whether any of a direction's light comes from above the surface.
bool above(int n) {
    vec4 a = texelFetch(u_directions, texel_of(2 * n), 0);
    return dot(N, a.xyz) > -2.0 * (a.w + turn(a.xyz));
}

// Whether a direction's parts replace it whatever the lobe.
bool close_by(Direction d) { return false; }
