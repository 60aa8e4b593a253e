// Indirect light at a camera's pixels, from a smaller and noisy picture of it: the mean over what lies near on the same
// stretch of surface (joint bilateral upsampling; Kopf et al. 2007, "Joint Bilateral Upsampling").
#include "include/pixel.glsl"
uniform sampler2D u_small_position;  // the small picture's pixels: world xyz, coverage
uniform sampler2D u_small_normal;
uniform sampler2D u_small_irradiance;
uniform sampler2D u_small_glossy;

layout(location = 0) out vec4 o_irradiance;  // RGB, W/m^2
layout(location = 1) out vec4 o_glossy;      // RGB, W/(m^2 sr)

uniform vec4 u_part;                 // of the small picture that the pixels show: x, y, width, height, of 1
uniform mat4 u_small_clip;           // world to the small picture's clip space
uniform int u_reach;                 // small pixels
uniform float u_sigma;               // small pixels: width of the Gaussian

const float SHARPNESS = 16.0; // power of the cosine between two normals
const float OTHER = 1e-4;     // weight of what lies elsewhere, for pixels that have nothing near
const float SPARK = 24.0;     // times the typical value: what is brighter is a rare path, cut to that

vec4 p;
vec3 n;
vec2 center;
float width;

// How well a pixel of the small picture stands for this one.
float weight_of(ivec2 at) {
    vec4 q = texelFetch(u_small_position, at, 0);
    if (q.w < 0.5) return 0.0;
    vec2 off = vec2(at) + 0.5 - center;
    float height = dot(q.xyz - p.xyz, n) / width;
    float same = pow(max(dot(texelFetch(u_small_normal, at, 0).xyz, n), 0.0), SHARPNESS);
    return exp(-dot(off, off) / (2.0 * u_sigma * u_sigma)) * (same * exp(-height * height) + OTHER);
}

vec3 cut(vec3 value, float typical) {
    return value * min(1.0, SPARK * typical / max(dot(value, vec3(1.0)), 1e-30));
}

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy), small = textureSize(u_small_position, 0);
    p = texelFetch(u_position, at, 0);
    if (p.w < 0.5) discard;
    n = texelFetch(u_normal, at, 0).xyz;
    vec2 ratio = vec2(textureSize(u_position, 0)) / (vec2(small) * u_part.zw);
#ifdef LENS
    vec4 clip = u_small_clip * vec4(p.xyz, 1.0);
    center = clamp(clip.xy / max(clip.w, 1e-20) * 0.5 + 0.5, 0.0, 1.0) * vec2(small);
#else
    center = u_part.xy * vec2(small) + gl_FragCoord.xy / ratio;
#endif
    width = u_sigma * max(ratio.x, ratio.y) * pixel_width(p.xyz);
    ivec2 first = max(ivec2(floor(center)) - u_reach, ivec2(0)), last = min(ivec2(floor(center)) + u_reach, small - 1);
    vec2 root = vec2(0.0);  // the mean of roots, squared, is a typical value that hardly hears of sparks
    float total = 1e-30;
    for (int y = first.y; y <= last.y; y++) for (int x = first.x; x <= last.x; x++) {
        float w = weight_of(ivec2(x, y));
        root += w * sqrt(max(vec2(dot(texelFetch(u_small_irradiance, ivec2(x, y), 0).rgb, vec3(1.0)),
                                  dot(texelFetch(u_small_glossy, ivec2(x, y), 0).rgb, vec3(1.0))), 0.0));
        total += w;
    }
    vec2 typical = root * root / (total * total);
    vec3 irradiance = vec3(0.0), glossy = vec3(0.0);
    for (int y = first.y; y <= last.y; y++) for (int x = first.x; x <= last.x; x++) {
        float w = weight_of(ivec2(x, y));
        irradiance += w * cut(texelFetch(u_small_irradiance, ivec2(x, y), 0).rgb, typical.x);
        glossy += w * cut(texelFetch(u_small_glossy, ivec2(x, y), 0).rgb, typical.y);
    }
    o_irradiance = vec4(irradiance / total, 0.0);
    o_glossy = vec4(glossy / total, 0.0);
}
