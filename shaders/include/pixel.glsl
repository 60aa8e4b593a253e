// A camera's pixel: the surface at its centre and over its footprint.
#include "include/projection.glsl"
uniform sampler2D u_position;       // pixel grid: world xyz, coverage: 0 or 1, at seams less
uniform sampler2D u_normal;         // shading normal, slot
uniform vec3 u_camera_position;
uniform vec3 u_camera_forward;
uniform bool u_orthographic;
uniform float u_pixel_width;        // metres (orthographic) or metres per metre of depth
uniform float u_footprint;          // width, in pixels, of the box over which a pixel averages

const int SILHOUETTE = 512;         // in what observe/rim.frag leaves
const float MIN_COS_L = 0.08;       // the terminator: there the irradiance is wrong by the facets' own error

struct Pixel {
    vec3 P, N;
    vec3 dPdx, dPdy, dNdx, dNdy;  // per pixel step
    float bend2;                  // how much the normal bends over the footprint, squared: 0 where it turns steadily
};

// Does a pixel show more than the UV island of its centre?  ``p``: its position.
bool at_seam(vec4 p) {
    return p.w < 1.0 - 0.5 * SEAM;
}

vec3 toward_camera(vec3 P) {
    return u_orthographic ? -u_camera_forward : normalize(u_camera_position - P);
}

// The twin of pixel_widths in core/projection.py.
float pixel_width(vec3 P) {
#ifdef LENS
    vec3 local = (u_to_lens * vec4(P, 1.0)).xyz;
    return u_pixel_width * max(lens_depth(local), 0.0) / least_scale(local);
#else
    return u_orthographic ? u_pixel_width : u_pixel_width * max(dot(P - u_camera_position, u_camera_forward), 0.0);
#endif
}

// Are two pixels `steps` apart on one stretch of surface?  Farther apart in space than a slanted
// plane would put them, or the other way round, they are two surfaces.
bool same_surface(vec4 a, vec4 b, float slant, float steps) {
    return b.w > 0.5 && distance(a.xyz, b.xyz) < 4.0 * steps * pixel_width(a.xyz) / slant;
}

// Central difference along `axis` where both neighbours lie on the surface, one-sided where one does.
// bend2: squared distance of the normal from the mean of its neighbours'; 0 where one is missing.
void slopes(ivec2 at, ivec2 axis, vec4 p, vec3 n, float slant, out vec3 dP, out vec3 dN, out float bend2) {
    vec4 before = texelFetch(u_position, max(at - axis, ivec2(0)), 0);
    vec4 after = texelFetch(u_position, min(at + axis, textureSize(u_position, 0) - 1), 0);
    bool has_before = same_surface(p, before, slant, 1.0), has_after = same_surface(p, after, slant, 1.0);
    vec3 nb = has_before ? texelFetch(u_normal, max(at - axis, ivec2(0)), 0).xyz : n;
    vec3 na = has_after ? texelFetch(u_normal, min(at + axis, textureSize(u_position, 0) - 1), 0).xyz : n;
    float steps = max(float(has_before) + float(has_after), 1.0);
    dP = ((has_after ? after.xyz : p.xyz) - (has_before ? before.xyz : p.xyz)) / steps;
    dN = (na - nb) / steps;
    vec3 off = has_before && has_after ? 0.5 * (na + nb) - n : vec3(0.0);
    bend2 = dot(off, off);
}

bool load_pixel(ivec2 at, out Pixel pixel) {
    vec4 p = texelFetch(u_position, at, 0);
    if (p.w < 0.5) return false;
    pixel.P = p.xyz;
    pixel.N = texelFetch(u_normal, at, 0).xyz;
    float slant = max(abs(dot(pixel.N, toward_camera(p.xyz))), 0.15);
    float across, along;
    slopes(at, ivec2(1, 0), p, pixel.N, slant, pixel.dPdx, pixel.dNdx, across);
    slopes(at, ivec2(0, 1), p, pixel.N, slant, pixel.dPdy, pixel.dNdy, along);
    float area = u_footprint * u_footprint;
    pixel.bend2 = area * area * (across + along);
    return true;
}

// The j-th of the four points of the 2 x 2 Gauss rule over the footprint.
void footprint_point(Pixel pixel, int j, out vec3 P, out vec3 N) {
    const float GAUSS = 0.28867513;  // 1 / (2 sqrt 3): half-width 1/2 times 1/sqrt 3
    vec2 d = vec2((j & 1) == 0 ? -1.0 : 1.0, (j & 2) == 0 ? -1.0 : 1.0) * GAUSS * u_footprint;
    P = pixel.P + d.x * pixel.dPdx + d.y * pixel.dPdy;
    N = normalize(pixel.N + d.x * pixel.dNdx + d.y * pixel.dNdy);
}
