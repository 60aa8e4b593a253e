// Patches of meshes that glow, as directions from P (twin: seen_from in irpso_addon/core/shading/emitters.py).
uniform sampler2D u_directions;  // three texels each: place, size; normal, 0; power, 0.  Parts follow as of a world

// Mean of max(cosine, 0) over a patch whose normals' mean has a cosine; its normals are spread evenly about it.
float facing_of(float cosine, vec3 normal) {
    return clamped_mean(cosine, sqrt(1.5 * max(1.0 - dot(normal, normal), 1e-12)));
}

Direction direction(int n) {
    vec4 place = texelFetch(u_directions, texel_of(3 * n), 0);
    vec3 normal = texelFetch(u_directions, texel_of(3 * n + 1), 0).xyz, offset = place.xyz - P;
    float inv = inversesqrt(max(dot(offset, offset), 1e-20));
    float facing = -dot(normal, offset) * inv;
    vec3 power = texelFetch(u_directions, texel_of(3 * n + 2), 0).rgb * (facing_of(facing, normal) * inv * inv);
    return Direction(offset * inv, place.w * inv * sqrt(0.5 + 0.5 * facing * facing), power);
}

bool above(int n) {
    vec4 place = texelFetch(u_directions, texel_of(3 * n), 0);
    vec3 offset = place.xyz - P;
    return dot(N, offset) > -2.0 * (place.w + turn(offset));
}

bool close_by(Direction d) { return d.spread * d.spread > NEAR; }
