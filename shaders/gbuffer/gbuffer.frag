// G-buffer: what the surface is at a texel or a pixel.
in vec3 v_position;
in vec3 v_normal;
in vec2 v_uv;
in vec2 v_grid;
flat in vec4 v_facet;
#ifdef NORMAL_MAP
in vec3 v_object_normal;
in vec4 v_tangent;

uniform sampler2D u_normal_map;  // tangent space, 0..1
uniform bool u_has_normal_map;
uniform float u_normal_strength;
uniform bool u_unit_normal;
uniform mat3 u_normal_matrix;    // inverse transpose of the object's matrix
#endif
uniform sampler2D u_tilt;        // over the texel grid: what is added to unit normals, world
uniform bool u_has_tilt;
uniform float u_slot;
uniform float u_footprint;       // width of the box over which a pixel averages, in pixels; 0 for texels

layout(location = 0) out vec4 o_position;  // world, coverage
layout(location = 1) out vec4 o_normal;    // shading normal, material slot
layout(location = 2) out vec4 o_facet;     // facet normal on the shading side, lift
layout(location = 3) out vec4 o_uv;        // place on the texel grid
layout(location = 4) out vec4 o_uv_slope;  // its change per pixel along x, along y

#ifdef NORMAL_MAP
// Blender's Normal Map node: combined in object space, because under non-uniform scale the world-space
// frame is wrong by degrees.  Blender 5 makes the interpolated normal unit length first, 4.5 does not.
vec3 mapped_normal(vec2 uv) {
    vec3 c = texture(u_normal_map, uv).xyz * 2.0 - 1.0;
    c = vec3(c.xy * u_normal_strength, mix(1.0, c.z, clamp(u_normal_strength, 0.0, 1.0)));
    vec3 n = u_unit_normal ? normalize(v_object_normal) : v_object_normal;
    vec3 bitangent = v_tangent.w * cross(n, v_tangent.xyz);
    return normalize(u_normal_matrix * (c.x * v_tangent.xyz + c.y * bitangent + c.z * n));
}

// Mean of the mapped normal over the pixel's footprint (a texel: its centre).
vec3 mean_mapped_normal() {
    vec2 dx = dFdx(v_uv) * u_footprint, dy = dFdy(v_uv) * u_footprint;
    vec3 sum = vec3(0.0);
    for (int j = 0; j < 16; j++) {
        vec2 d = (vec2(float(j & 3), float(j >> 2)) - 1.5) * 0.25;
        sum += mapped_normal(v_uv + d.x * dx + d.y * dy);
    }
    return sum;
}
#endif

// Mean over the footprint of what refined normals add.
vec3 mean_tilt() {
    vec2 dx = dFdx(v_grid) * u_footprint, dy = dFdy(v_grid) * u_footprint;
    vec3 sum = vec3(0.0);
    for (int j = 0; j < 16; j++) {
        vec2 d = (vec2(float(j & 3), float(j >> 2)) - 1.5) * 0.25;
        sum += texture(u_tilt, v_grid + d.x * dx + d.y * dy).xyz;
    }
    return sum / 16.0;
}

void main() {
#ifdef NORMAL_MAP
    vec3 n = normalize(u_has_normal_map ? mean_mapped_normal() : v_normal);
#else
    vec3 n = normalize(v_normal);
#endif
    if (u_has_tilt) n = normalize(n + mean_tilt());
    o_position = vec4(v_position, 1.0);
    o_normal = vec4(n, u_slot);
    o_facet = vec4(v_facet.xyz * (dot(v_facet.xyz, v_normal) < 0.0 ? -1.0 : 1.0), v_facet.w);
    o_uv = vec4(v_grid, 0.0, 0.0);
    o_uv_slope = vec4(dFdx(v_grid), dFdy(v_grid));
}
