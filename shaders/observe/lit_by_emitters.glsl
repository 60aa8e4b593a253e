// The shadows of patches of meshes that glow.
uniform sampler2D u_sights;      // of each patch: from where its shadows are seen; its first map, of six: -1 - that
uniform vec3 u_center;           // of the subject's sphere
uniform float u_radius;

// Share of the light of the batch's n-th patch that arrives, by a perspective map.
float lit_of(int n, Direction d, vec4 facet) {
    vec4 sight = texelFetch(u_sights, texel_of(u_first + n), 0);
    vec3 axis = u_center - sight.xyz, away = P - sight.xyz;
    float reach = length(axis), half_width = 1.001;
    int map = int(sight.w);
    if (map >= 0) half_width = 1.01 * u_radius * inversesqrt(reach * reach - u_radius * u_radius);
    float texel = 2.0 * half_width / float(SHADOW_SIDE) * length(away);
    vec3 lifted = away + N * rise(facet, -normalize(away)) + facet.xyz * LIFT * texel, forward = axis / reach;
    if (map < 0) {  // a cube's face, by the longest component: +X +Y +Z -X -Y -Z
        vec3 a = abs(lifted);
        int longest = a.x >= a.y && a.x >= a.z ? 0 : (a.y >= a.z ? 1 : 2);
        bool positive = lifted[longest] >= 0.0;
        forward = vec3(0.0);
        forward[longest] = positive ? 1.0 : -1.0;
        map = -1 - map + longest + (positive ? 0 : 3);
    }
    vec3 right = right_of(forward), up = cross(right, forward);
    float depth = max(dot(forward, lifted), 1e-9);
    vec2 at = (vec2(dot(right, lifted), dot(up, lifted)) / (depth * half_width) * 0.5 + 0.5) * float(SHADOW_SIDE) - 0.5;
    return lit_in(u_shadow, corner_of(map), SHADOW_SIDE, at, depth - dot(forward, axis) - BIAS * texel,
                  depth_slope(facet.xyz, lifted / depth, right, up, texel));
}
