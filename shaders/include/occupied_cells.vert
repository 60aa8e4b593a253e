// Squares of pixels, one an instance; the fragment's pixel is gl_FragCoord.
in vec2 in_cell;      // column and row of the square
uniform vec2 u_cell;  // its width and height in clip space

void main() {
    vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1);
    gl_Position = vec4((in_cell + corner) * u_cell - 1.0, 0.0, 1.0);
}
