// Indirect light at a camera's pixels, from a smaller and noisy picture of it: the mean over what lies near on the same
// stretch of surface (joint bilateral upsampling; Kopf et al. 2007, "Joint Bilateral Upsampling").
#include "include/pixel.glsl"
uniform sampler2D u_small_position;  // the small picture's pixels: world xyz, coverage
uniform sampler2D u_small_normal;
uniform sampler2D u_small_irradiance;
uniform sampler2D u_small_glossy;

layout(location = 0) out vec4 o_irradiance;  // RGB, W/m^2
layout(location = 1) out vec4 o_glossy;      // RGB, W/(m^2 sr)

uniform int u_reach;                 // small pixels
uniform float u_sigma;               // small pixels: width of the Gaussian

const float SHARPNESS = 16.0; // power of the cosine between two normals
const float OTHER = 1e-4;     // weight of what lies elsewhere, for pixels that have nothing near

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy), small = textureSize(u_small_position, 0);
    vec4 p = texelFetch(u_position, at, 0);
    if (p.w < 0.5) discard;
    vec3 n = texelFetch(u_normal, at, 0).xyz;
    vec2 ratio = vec2(textureSize(u_position, 0)) / vec2(small);
    vec2 center = gl_FragCoord.xy / ratio;
    float width = u_sigma * max(ratio.x, ratio.y) * pixel_width(p.xyz);
    ivec2 first = max(ivec2(floor(center)) - u_reach, ivec2(0)), last = min(ivec2(floor(center)) + u_reach, small - 1);
    vec3 irradiance = vec3(0.0), glossy = vec3(0.0);
    float total = 0.0;
    for (int y = first.y; y <= last.y; y++) for (int x = first.x; x <= last.x; x++) {
        vec4 q = texelFetch(u_small_position, ivec2(x, y), 0);
        if (q.w < 0.5) continue;
        vec2 off = vec2(x, y) + 0.5 - center;
        float height = dot(q.xyz - p.xyz, n) / width;
        float same = pow(max(dot(texelFetch(u_small_normal, ivec2(x, y), 0).xyz, n), 0.0), SHARPNESS);
        float w = exp(-dot(off, off) / (2.0 * u_sigma * u_sigma)) * (same * exp(-height * height) + OTHER);
        irradiance += w * texelFetch(u_small_irradiance, ivec2(x, y), 0).rgb;
        glossy += w * texelFetch(u_small_glossy, ivec2(x, y), 0).rgb;
        total += w;
    }
    total = max(total, 1e-30);
    o_irradiance = vec4(irradiance / total, 0.0);
    o_glossy = vec4(glossy / total, 0.0);
}
