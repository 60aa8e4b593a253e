// Directions of light from all around, or patches of meshes that glow, and which of a batch light a pixel.
uniform int u_first;             // direction of the batch
uniform int u_count;             // directions in it
uniform int u_all;               // directions in all

vec3 P, N;
vec3 dx, dy;                     // of the normal, per pixel step

// Standard deviation, over the pixel, of the cosine to a direction.
float turn(vec3 toward) {
    float a = dot(dx, toward), b = dot(dy, toward);
    return u_footprint * sqrt((a * a + b * b) / 12.0);
}

struct Direction { vec3 toward; float spread; vec3 power; };

ivec2 texel_of(int at) {
    return ivec2(uint(at) % uint(DATA_WIDTH), uint(at) / uint(DATA_WIDTH));
}

// Some of a batch's 64 directions: a bit each.
struct Batch { uint low, high; };

Batch none() { return Batch(0u, 0u); }

bool some(Batch of) { return (of.low | of.high) != 0u; }

// Take the first of some directions; returns which.
int taken_from(inout Batch waiting) {
    bool low = waiting.low != 0u;
    uint bits = low ? waiting.low : waiting.high, first = bits & (~bits + 1u);
    waiting.low ^= low ? first : 0u;
    waiting.high ^= low ? 0u : first;
    return (floatBitsToInt(float(first)) >> 23) - (low ? 127 : 127 - 32);  // a power of two is its exponent
}

// Mean of max(x, 0) where x is spread evenly about a middle.
float clamped_mean(float middle, float half_width) {
    if (abs(middle) >= half_width) return max(middle, 0.0);
    return (middle + half_width) * (middle + half_width) / (4.0 * half_width);
}

#ifdef EMITTERS
#include "observe/from_emitters.glsl"
#else
#include "observe/from_world.glsl"
#endif
