// Albedo that a camera's pixel shows, at the roughness found: numerator and denominator of the
// least-squares albedo of VIEWS views, added over all the camera's views.  Errors count relative to what
// the albedo of the pass before predicts, and views far from it (missed shadows) lose their weight
// (Cauchy, by iteratively reweighted least squares; Holland and Welsch 1977).
// BY_LIGHT: where u_by_light is not 0, views count by a power of their irradiance, and good ones keep their weight: there
// the model is known to err, more where less light arrives, so that a view far from the others is no exception.
// Of a metal, whose multiple scattering depends on the albedo too, each pass is a step of Gauss and Newton.  A rough
// diffuse, which depends on it less, is that of the albedo of the pass before.
#include "include/lobes.glsl"
uniform sampler2D u_position;   // pixel grid
uniform sampler2D u_normal;
uniform sampler2D u_uv;
uniform sampler2D u_colour[VIEWS];    // f (1/sr), quality
uniform sampler2D u_specular[VIEWS];  // of the view's lights, 1/sr
#ifdef METALLIC
uniform sampler2D u_metal[VIEWS];     // see maps/albedo_specular.frag
#endif
#ifdef ROUGH_DIFFUSE
uniform sampler2D u_more[VIEWS];      // see o_rough there
#endif
#ifdef BY_LIGHT
uniform sampler2D u_light[VIEWS];     // irradiance over a typical one
#ifdef COAT
#define POWER u_coat
#else
uniform sampler2D u_by_light;         // texel grid: the power of it by which views count
#define POWER u_by_light
#endif
float by_light, good_quality;         // here; from where on a view is a good one
#endif
uniform sampler2D u_before;     // albedo sum of the pass before
uniform sampler2D u_before_weight;
uniform bool u_first_pass;
uniform float u_outlier;        // relative error at which a view loses half its weight
uniform vec3 u_camera_position;
uniform vec3 u_camera_forward;
uniform bool u_orthographic;
uniform vec3 u_tint[VIEWS];     // light per channel, mean 1

layout(location = 0) out vec4 o_albedo;  // weighted albedo sum
layout(location = 1) out vec4 o_weight;  // and what it would be if all views counted alike, of the channel that has most

#if defined(METALLIC) || defined(ROUGH_DIFFUSE)
#define WHITE vec3  // what a channel of white returns, as each of them has it
#else
#define WHITE float
#endif
#ifdef METALLIC
const float DARK = 0.25;  // beside its highlight a metal is dark: of Lambert's, below which errors are not relative
vec3 gain, d_gain;  // of a metal, and its derivative by base colour
#endif

void add_view(vec4 colour, float light, vec3 s, vec3 tint, WHITE diffuse, vec3 before) {
    if (colour.a <= 0.0) return;
    vec3 lit = vec3(greaterThan(colour.rgb, vec3(UNLIT_BELOW)));  // channels that the view's lights have
    vec3 expected = s + diffuse * before;
    float grey = max(dot(expected, vec3(1.0 / 3.0)), 1e-4);
#ifdef METALLIC
    grey = max(grey, DARK / PI * dot(before, vec3(1.0 / 3.0)));
#endif
    float w = colour.a / (grey * grey), by = 1.0;
    bool doubts = !u_first_pass;
#ifdef BY_LIGHT
    by = pow(max(light, 1e-6), by_light);
    doubts = doubts && (by_light < 0.5 || colour.a < good_quality);
#endif
    if (doubts) {
        float off = dot(lit, colour.rgb - expected) / (max(dot(lit, vec3(1.0)), 1.0) * grey);
        w /= 1.0 + off * off / (u_outlier * u_outlier);
    }
    vec3 dim = min(tint, 1.0);  // the camera's own noise counts for more where there is little light
    vec3 weight = lit * w * dim * dim * diffuse, information = weight * diffuse;
    o_albedo += vec4(by * weight * (colour.rgb - s), 1.0);
    o_weight += vec4(by * information, max(information.r, max(information.g, information.b)));
}

#ifdef METALLIC
// The same of a view with a metal's lobe, linear about the base colour of the pass before.
void add_metal(vec4 colour, float light, vec4 specular, vec4 metal, vec3 tint, vec3 diffuse, vec3 before) {
    vec3 black = metal.rgb * (specular.a / max(metal.a, 1e-20));  // of several lamps' colours: the mean share
    vec3 bend = d_gain * (before * metal.rgb + black);
    add_view(colour, light, specular.rgb + gain * black - before * bend, tint, diffuse + gain * metal.rgb + bend, before);
}
#endif

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec4 p = texelFetch(u_position, at, 0);
    if (p.w < 0.5) discard;
    vec3 V = u_orthographic ? -u_camera_forward : normalize(u_camera_position - p.xyz);
    float cos_v = clamp(dot(texelFetch(u_normal, at, 0).xyz, V), 1e-3, 1.0);
    Found found = found_at(texelFetch(u_uv, at, 0).xy);
    float diffuse = diffuse_of(found, cos_v);
#ifdef COAT
    diffuse *= left_by_coat(coat_at(texelFetch(u_uv, at, 0).xy), cos_v);
#endif
    vec3 before = vec3(0.5);
    if (!u_first_pass) {
        before = texelFetch(u_before, at, 0).rgb / max(texelFetch(u_before_weight, at, 0).rgb, vec3(1e-12));
    }
    before = clamp(before, 0.0, 1.0);
    o_albedo = o_weight = vec4(0.0);
#define AT(image) texelFetch(image, at, 0)
#ifdef BY_LIGHT
    by_light = textureLod(POWER, texelFetch(u_uv, at, 0).xy, 0.0).b;
    good_quality = 0.5 * cos_v * cos_v;
#define LIGHT(k) AT(u_light[k]).r
#else
#define LIGHT(k) 1.0
#endif
#ifdef ROUGH_DIFFUSE
    vec3 bounce = rough_bounce(before, rough_at(texelFetch(u_uv, at, 0).xy));
#define DIFFUSE(k) (diffuse * (1.0 + AT(u_more[k]).rgb + AT(u_more[k]).a * bounce))
#else
#define DIFFUSE(k) WHITE(diffuse)
#endif
#ifdef METALLIC
    diffuse *= 1.0 - metallic_at(texelFetch(u_uv, at, 0).xy);
    metal_gain_of(found, cos_v, before, gain, d_gain);
#define ADD_VIEW(k) add_metal(AT(u_colour[k]), LIGHT(k), AT(u_specular[k]), AT(u_metal[k]), u_tint[k], DIFFUSE(k), before)
#else
#define ADD_VIEW(k) add_view(AT(u_colour[k]), LIGHT(k), AT(u_specular[k]).rgb, u_tint[k], DIFFUSE(k), before)
#endif
    // An array of samplers takes constant indices alone.
    ADD_VIEW(0);
#if VIEWS > 1
    ADD_VIEW(1);
#endif
#if VIEWS > 2
    ADD_VIEW(2);
#endif
#if VIEWS > 3
    ADD_VIEW(3);
#endif
}
