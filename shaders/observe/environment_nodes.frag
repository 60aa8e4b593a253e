// One node of roughness of what a lobe returns of an environment: relative to the irradiance.
#include "include/brdf.glsl"
uniform sampler2D u_sums;        // as observe/environment.frag leaves a node
uniform sampler2D u_irradiance;
uniform ivec2 u_corner;          // of the node's place in the target

layout(location = 0) out vec4 o_node;  // RGB, 1/sr; V.H at which Fresnel's reflectance is the lobe's

// The cosine at which F_dielectric has a value: it falls from 1 at 0 to 0.04 at 1.
float cosine_of(float reflectance) {
    float low = 0.0, high = 1.0;
    for (int i = 0; i < 14; i++) {
        float middle = 0.5 * (low + high);
        if (F_dielectric(middle) > reflectance) low = middle;
        else high = middle;
    }
    return 0.5 * (low + high);
}

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy) - u_corner;
    vec4 sums = texelFetch(u_sums, at, 0), irradiance = texelFetch(u_irradiance, at, 0);
    float mean = dot(irradiance.rgb, vec3(1.0 / 3.0));
    vec3 lit = vec3(greaterThan(irradiance.rgb, vec3(1e-3 * mean)));
    vec3 node = lit * sums.rgb / max(irradiance.rgb, vec3(1e-20));
    o_node = vec4(min(node, vec3(6e4)), cosine_of(dot(sums.rgb, vec3(1.0 / 3.0)) / max(sums.a, 1e-20)));
}
