// Stateless random numbers: a hash of (texel, particle, step, seed), so that the result does not
// depend on the order or the size of tiles.  PCG3D: Jarzynski and Olano, JCGT 9(3), 2020.
uvec3 hash3(uvec3 v) {
    v = v * 1664525u + 1013904223u;
    v.x += v.y * v.z; v.y += v.z * v.x; v.z += v.x * v.y;
    v ^= v >> 16u;
    v.x += v.y * v.z; v.y += v.z * v.x; v.z += v.x * v.y;
    return v;
}

// Three numbers in [0, 1).
vec3 random3(ivec2 texel, int particle, int step, int seed) {
    uvec3 h = hash3(uvec3(uint(texel.x) | (uint(texel.y) << 16u), uint(particle) | (uint(step) << 12u), uint(seed)));
    return vec3(h >> 8u) * (1.0 / 16777216.0);
}
