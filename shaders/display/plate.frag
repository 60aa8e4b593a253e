// A picture or map as blender/viewer/views.py's Plate says.  Alpha 0 of a texture: nothing is known there.
// Constants: kind (order of view_draw.KINDS), wipe (left of it the first, right of it the second), gain (of colour),
// top (heat of the brightest colour), least (denominator of relative errors, at least).

// IEC 61966-2-1, decoding: the editor's frame buffer encodes what is written to it.
vec3 decoded(vec3 value)
{
  return mix(value / 12.92, pow((value + 0.055) / 1.055, vec3(2.4)), step(vec3(0.04045), value));
}

// Five colours whose lightness grows evenly, so that a print in grey reads alike.
vec3 heat(float x)
{
  const vec3 ramp[5] = vec3[5](vec3(0.05, 0.04, 0.16), vec3(0.36, 0.10, 0.45), vec3(0.78, 0.22, 0.34),
                               vec3(0.97, 0.58, 0.20), vec3(0.99, 0.97, 0.75));
  float at = clamp(x, 0.0, 1.0) * 4.0;
  int low = min(int(at), 3);
  return decoded(mix(ramp[low], ramp[low + 1], at - float(low)));
}

float mean(vec3 value)
{
  return (value.r + value.g + value.b) / 3.0;
}

void main()
{
  vec4 one = texture(first, uv), other = texture(second, uv);
  vec4 here = uv.x < wipe ? one : other;
  float known = here.a;
  vec3 shown;
  if (kind == 0)
    shown = here.rgb / max(here.a, 1e-3) * gain;
  else if (kind == 1)
    shown = decoded(clamp(here.rgb / max(here.a, 1e-3), 0.0, 1.0));
  else if (kind == 2)
    shown = heat(here.r / max(here.a, 1e-3) / top);
  else if (kind == 5)
    shown = heat(uv.x);  // the legend
  else {
    vec3 a = one.rgb / max(one.a, 1e-3), b = other.rgb / max(other.a, 1e-3);
    known = min(one.a, other.a);
    shown = heat(mean(abs(a - b)) / (kind == 3 ? max(mean(a), least) : 1.0) / top);
  }
  color = vec4(clamp(shown, 0.0, 1.0), kind == 5 ? 1.0 : known);
}
