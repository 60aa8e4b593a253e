// Where a camera's picture shows a place, in clip space; w <= 0: nowhere.  A lens as of core/lens.py.
uniform mat4 u_clip;         // from the world; with a lens, from where it bends places
#ifdef LENS
uniform mat4 u_to_lens;      // world to camera axes: x right, y down, z forward
uniform vec4 u_radial;       // k1 to k4
uniform vec2 u_tangential;   // p1, p2
uniform bool u_fisheye;
uniform float u_lens_reach;  // r (fisheye: angle) at which the radial polynomial turns back

// atan(across, depth) for across >= 0: drivers' own may be off by pixels.  Up to tan(pi / 8) the series' next term is
// below 2e-8.
float angle_off_axis(float across, float depth) {
    float least = min(across, abs(depth)), most = max(across, abs(depth));
    if (most <= 0.0) return 0.0;
    float t = least / most;
    bool high = t > 0.41421356;
    t = high ? (least - most) / (least + most) : t;
    float s = t * t;
    float angle = t * (1.0 + s * (-1.0 / 3.0 + s * (1.0 / 5.0 + s * (-1.0 / 7.0 + s * (1.0 / 9.0 + s * (
        -1.0 / 11.0 + s * (1.0 / 13.0 - s / 15.0)))))));
    angle = high ? 0.78539816 + angle : angle;
    angle = across > abs(depth) ? 1.57079633 - angle : angle;
    return depth < 0.0 ? 3.14159265 - angle : angle;
}

// r, or a fisheye's angle.
float off_axis(vec3 local) {
    float across = length(local.xy);
    return u_fisheye ? angle_off_axis(across, local.z) : (local.z > 0.0 ? across / local.z : 1e31);
}

// The depth or, of a fisheye, the distance.
float lens_depth(vec3 local) {
    return u_fisheye ? length(local) : local.z;
}

vec4 clip_of(vec3 P) {
    vec3 local = (u_to_lens * vec4(P, 1.0)).xyz;
    float r = off_axis(local), s = r * r, across = length(local.xy);
    if (r > u_lens_reach) return vec4(0.0, 0.0, 0.0, -1.0);
    vec2 flat_place = across > 0.0 ? local.xy * (r / across) : vec2(0.0);
    float x = flat_place.x, y = flat_place.y, radial = 1.0 + s * dot(u_radial, vec4(1.0, s, s * s, s * s * s));
    vec2 seen = flat_place * radial + vec2(
        2.0 * u_tangential.x * x * y + u_tangential.y * (s + 2.0 * x * x),
        u_tangential.x * (s + 2.0 * y * y) + 2.0 * u_tangential.y * x * y);
    return u_clip * vec4(vec3(seen, 1.0) * lens_depth(local), 1.0);
}

// As Lens.least_scale.
float least_scale(vec3 local) {
    float r = min(off_axis(local), u_lens_reach), s = r * r;
    vec4 powers = s * vec4(1.0, s, s * s, s * s * s);
    return max(1.0 + min(dot(u_radial, powers), dot(u_radial, powers * vec4(3.0, 5.0, 7.0, 9.0))), LEAST_SCALE);
}
#else
vec4 clip_of(vec3 P) {
    return u_clip * vec4(P, 1.0);
}
#endif
