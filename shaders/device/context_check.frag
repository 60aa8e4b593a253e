// A kept texel times a new number: see gpu/device/context_check.py.
uniform sampler2D u_kept;
uniform float u_number;

layout(location = 0) out vec4 o_song;

void main() {
    o_song = texelFetch(u_kept, ivec2(0), 0) * u_number;
}
