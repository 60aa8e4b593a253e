// Blender's own shader dialect: inputs, outputs and constants are declared by blender/viewer/view_draw.py.
void main()
{
  uv = place;
  gl_Position = mvp * vec4(position, 0.0, 1.0);
}
