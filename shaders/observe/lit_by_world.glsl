// The shadows of an environment's directions.
uniform vec3 u_center;           // of the subject's sphere
uniform float u_half_width;      // of a shadow map, metres

// Share of the light of the batch's n-th direction that arrives, by a parallel map.
float lit_of(int n, Direction d, vec4 facet) {
    vec3 forward = -d.toward;
    vec3 right = right_of(forward), up = cross(right, forward);
    float texel = 2.0 * u_half_width / float(SHADOW_SIDE);
    vec3 lifted = P + N * rise(facet, d.toward) + facet.xyz * LIFT * texel - u_center;
    vec2 at = vec2(dot(right, lifted), dot(up, lifted)) / texel + 0.5 * float(SHADOW_SIDE) - 0.5;
    return softly_lit_in(u_shadow, corner_of(n), SHADOW_SIDE, at, dot(forward, lifted) - BIAS * texel,
                         depth_slope(facet.xyz, forward, right, up, texel), d.spread / texel, u_half_width);
}
