// Albedo that a camera's pixel shows, at the roughness found: numerator and denominator of the
// least-squares albedo of VIEWS views, added over all the camera's views.  Errors count relative to what
// the albedo of the pass before predicts, and views far from it (missed shadows) lose their weight
// (Cauchy, by iteratively reweighted least squares; Holland and Welsch 1977).
#include "include/lobes.glsl"
uniform sampler2D u_position;   // pixel grid
uniform sampler2D u_normal;
uniform sampler2D u_uv;
uniform sampler2D u_colour[VIEWS];    // f (1/sr), quality
uniform sampler2D u_specular[VIEWS];  // of the view's lights, 1/sr
uniform sampler2D u_before;     // albedo sum of the pass before
uniform sampler2D u_before_weight;
uniform bool u_first_pass;
uniform float u_outlier;        // relative error at which a view loses half its weight
uniform vec3 u_camera_position;
uniform vec3 u_camera_forward;
uniform bool u_orthographic;
uniform vec3 u_tint[VIEWS];     // light per channel, mean 1

layout(location = 0) out vec4 o_albedo;  // weighted albedo sum
layout(location = 1) out vec4 o_weight;

void add_view(vec4 colour, vec3 s, vec3 tint, float diffuse, vec3 before) {
    if (colour.a <= 0.0) return;
    vec3 lit = vec3(greaterThan(colour.rgb, vec3(-100.0)));  // channels that the view's lights have
    vec3 expected = s + diffuse * before;
    float grey = max(dot(expected, vec3(1.0 / 3.0)), 1e-4);
    float w = colour.a / (grey * grey);
    if (!u_first_pass) {
        float off = dot(lit, colour.rgb - expected) / (max(dot(lit, vec3(1.0)), 1.0) * grey);
        w /= 1.0 + off * off / (u_outlier * u_outlier);
    }
    vec3 dim = min(tint, 1.0);  // the camera's own noise counts for more where there is little light
    vec3 weight = lit * w * dim * dim * diffuse;
    o_albedo += vec4(weight * (colour.rgb - s), 1.0);
    o_weight += vec4(weight * diffuse, 1.0);
}

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec4 p = texelFetch(u_position, at, 0);
    if (p.w < 0.5) discard;
    vec3 V = u_orthographic ? -u_camera_forward : normalize(u_camera_position - p.xyz);
    float cos_v = clamp(dot(texelFetch(u_normal, at, 0).xyz, V), 1e-3, 1.0);
    float diffuse = diffuse_of(found_at(texelFetch(u_uv, at, 0).xy), cos_v);
    vec3 before = vec3(0.5);
    if (!u_first_pass) {
        before = texelFetch(u_before, at, 0).rgb / max(texelFetch(u_before_weight, at, 0).rgb, vec3(1e-12));
    }
    before = clamp(before, 0.0, 1.0);
    o_albedo = o_weight = vec4(0.0);
    // An array of samplers takes constant indices alone.
    add_view(texelFetch(u_colour[0], at, 0), texelFetch(u_specular[0], at, 0).rgb, u_tint[0], diffuse, before);
#if VIEWS > 1
    add_view(texelFetch(u_colour[1], at, 0), texelFetch(u_specular[1], at, 0).rgb, u_tint[1], diffuse, before);
#endif
#if VIEWS > 2
    add_view(texelFetch(u_colour[2], at, 0), texelFetch(u_specular[2], at, 0).rgb, u_tint[2], diffuse, before);
#endif
#if VIEWS > 3
    add_view(texelFetch(u_colour[3], at, 0), texelFetch(u_specular[3], at, 0).rgb, u_tint[3], diffuse, before);
#endif
}
