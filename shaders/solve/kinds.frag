// One level up the pyramid: which two colours four cells have together (2-means, from the two colours farthest apart).
#include "solve/cells.glsl"
const int MOST = 8;
const int ROUNDS = 2;

layout(location = 0) out vec4 o_first;    // as u_colour above the finest cells
layout(location = 1) out vec4 o_second;
layout(location = 2) out vec4 o_members;  // which kinds of the four cells make up the first and the second, as bits

void main() {
    vec4 part[MOST];
    for (int n = 0; n < MOST; n++) {
        ivec2 cell = 2 * ivec2(gl_FragCoord.xy) + ivec2((n >> 1) & 1, n >> 2);
        bool there = (n & 1) < KINDS && all(lessThan(cell, cell_count()));
        part[n] = there ? cell_colour(cell, n & 1) : vec4(0.0);
    }
    vec3 first = vec3(0.0), second = vec3(0.0);
    float farthest = -1.0;
    for (int n = 0; n < MOST; n++) {
        for (int m = 0; m <= n; m++) {
            float off = squared(part[n].rgb - part[m].rgb);
            if (part[n].a > 0.0 && part[m].a > 0.0 && off > farthest) {
                farthest = off;
                first = part[m].rgb;
                second = part[n].rgb;
            }
        }
    }
    vec2 count = vec2(0.0), members = vec2(0.0);
    for (int round = 0; round < ROUNDS; round++) {
        vec3 sum = vec3(0.0), other = vec3(0.0);
        count = members = vec2(0.0);
        for (int n = 0; n < MOST; n++) {
            if (part[n].a <= 0.0) continue;
            bool nearer = squared(part[n].rgb - second) < squared(part[n].rgb - first);
            vec2 to = nearer ? vec2(0.0, 1.0) : vec2(1.0, 0.0);
            sum += to.x * part[n].a * part[n].rgb;
            other += to.y * part[n].a * part[n].rgb;
            count += to * part[n].a;
            members += to * float(1 << n);
        }
        if (count.x > 0.0) first = sum / count.x;
        if (count.y > 0.0) second = other / count.y;
    }
    o_first = vec4(first, count.x);
    o_second = vec4(second, count.y);
    o_members = vec4(members, 0.0, 0.0);
}
