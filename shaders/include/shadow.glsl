// Shadow mapping (Williams 1978) with bilinear percentage-closer filtering (Reeves et al. 1987).  Each tap compares with
// the depth of the receiver's facet at the tap: a surface at a slant does not shadow itself, and need not be lifted far.
const float LIFT = 0.5;   // texels of a shadow map by which a point is lifted along its facet's normal: curved surfaces
const float BIAS = 0.5;   // texels by which it is brought nearer to the light
const float GRAZING = 0.1;  // cosine to a facet below which light makes a point rise to the smooth surface, as in Cycles
const float STEEP = 5.0;  // most that a facet's depth changes in a texel, in widths of one

// How far a point of a facet (normal, height of the smooth surface above it) rises where light comes from `toward`: in full
// where the facet turns away from light that the smooth surface sees, not at all where it faces it.
float rise(vec4 facet, vec3 toward) {
    return facet.w * clamp(1.0 - dot(facet.xyz, toward) / GRAZING, 0.0, 1.0);
}

// The change of a facet's depth from one texel to the next, across and up, for texels of a width.
// `ray`: from the light to the point, at depth 1; `right` and `up`: the map's axes.
vec2 depth_slope(vec3 facet, vec3 ray, vec3 right, vec3 up, float texel) {
    float along = min(dot(facet, ray), -1e-3);
    return clamp(-vec2(dot(facet, right), dot(facet, up)) / along, -STEEP, STEEP) * texel;
}

// Where five looks that count alike see a square of directions of standard deviation 1, beside its middle: turned, so that
// an edge along an axis passes them one after the other, at 2/5 and 4/5 of the way to the square's sides.
const float INNER = 0.4 * 1.7320508, OUTER = 2.0 * INNER;
const vec2 AROUND[4] = vec2[](vec2(OUTER, INNER), vec2(-INNER, OUTER), vec2(-OUTER, -INNER), vec2(INNER, -OUTER));

// Depth of the texel at `at`, of a map as below.
float nearest_in(sampler2D sheet, ivec2 corner, int side, vec2 at) {
    return texelFetch(sheet, corner + clamp(ivec2(floor(at + 0.5)), ivec2(0), ivec2(side - 1)), 0).r;
}

// Share of four texels that is lit, at `at` in texels from the corner of a map that lies at `corner` in the sheet; `middle`:
// the depth of the nearest of them.
float lit_in(sampler2D sheet, ivec2 corner, int side, vec2 at, float depth, vec2 slope, out float middle) {
    ivec2 low = ivec2(floor(at));
    vec2 f = at - vec2(low);
    ivec2 a = corner + clamp(low, ivec2(0), ivec2(side - 1)), b = corner + clamp(low + 1, ivec2(0), ivec2(side - 1));
    vec4 nearest = vec4(texelFetch(sheet, a, 0).r, texelFetch(sheet, ivec2(b.x, a.y), 0).r,
                        texelFetch(sheet, ivec2(a.x, b.y), 0).r, texelFetch(sheet, b, 0).r);
    vec2 row = f.y < 0.5 ? nearest.xy : nearest.zw;
    middle = f.x < 0.5 ? row.x : row.y;
    float first = depth - dot(slope, f);
    vec4 lit = step(first + vec4(0.0, slope.x, slope.y, slope.x + slope.y), nearest);
    vec2 rows = mix(lit.xz, lit.yw, f.x);
    return mix(rows.x, rows.y, f.y);
}

float lit_in(sampler2D sheet, ivec2 corner, int side, vec2 at, float depth, vec2 slope) {
    float unused;
    return lit_in(sheet, corner, side, at, depth, slope, unused);
}

// The same of light that comes from several directions about one.  `spread`: their standard deviation along each of two
// axes, as texels for a metre of height of what is in the way; `reach`: metres of height at which that is looked for.
// First how high it is, then what each of four directions meets there (after Fernando 2005, "Percentage-Closer Soft
// Shadows"; here four and the middle one).
float softly_lit_in(sampler2D sheet, ivec2 corner, int side, vec2 at, float depth, vec2 slope, float spread, float reach) {
    float middle, lit = lit_in(sheet, corner, side, at, depth, slope, middle);
    float height = max(depth - middle, 0.0);  // not minus infinity: maps hold halves
    for (int k = 0; k < 4; k++) {
        vec2 off = spread * reach * AROUND[k];
        // The receiver's own facet, which may rise towards the light there, is not in the way.
        height = max(height, depth + min(dot(slope, off), 0.0) - nearest_in(sheet, corner, side, at + off));
    }
    if (spread * height < 1.0) return lit;  // the percentage of four texels is as soft
    float around = 0.0;
    for (int k = 0; k < 4; k++) {
        vec2 off = spread * height * AROUND[k];
        around += step(depth + min(dot(slope, off), 0.0), nearest_in(sheet, corner, side, at + off));
    }
    return 0.2 * (around + lit);
}
