"""From what was measured to what a user is told: a line for each cause, with its number, its name, and what to do.

A cause has many symptoms: a picture that is not linear is too bright here and too dark there, as under a lamp in the
wrong place; bounced light and a camera that is off make errors of every kind.  What explains the most is said, and the
errors that it makes do not count against others (``_floor``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ..check_records import Checks, LightResidual, Misfit
from .residuals import is_indirect, scale_of

LEAST_GAIN, LEAST_MOVE = 0.015, 0.01  # relative errors of brightness, of shading, below which nothing is said
EXPLAINED, SURE = 0.25, 0.7  # of the residual's variance that a light's move must explain; that leaves no doubt
LEAST_POWER, LEAST_POWER_ALONE = 0.02, 0.1  # how far from 1 an exponent must be: of all views, of one
LEAST_POWER_MISFIT = 0.3  # the same where a material is not what its model says: real diffuse reflection bends, too
SIGMAS, SIGMAS_POWER = 6.0, 3.0
LEAST_SHIFT = 0.1  # pixels
PER_PIXEL = 0.05  # relative error of brightness that a pixel of misregistration makes
CLIPPED = 0.01  # of the object's pixels
STRUCTURE, NOISE_SHARE = 0.004, 0.3  # relative errors that neighbouring pixels share, and beside the noise
HIGHLIGHT = 0.06  # such errors of highlights, relative to the lobes
COARSE = 2.0  # pixels a texel from which on maps cannot show what the pictures do
FEW = 0.1  # of a material's texels
DOUBTFUL = 0.05  # of the texels are off by more than 0.15, by their own standard errors
NAMED = 3  # views or lights that a line names


def warnings(checks: Checks) -> tuple[str, ...]:
    """What a user must know, the likeliest cause first; nothing where all is well."""
    curve = _curve(checks)
    causes = [*_indirect(checks), *curve, *_registration(checks)]
    if not curve:  # else its errors are of every kind
        causes += [*_curve_of_some(checks), *_lights(checks), *_exposures(checks)]
    return (*causes, *_clipped(checks), *([] if causes else _unexplained(checks)), *_few(checks), *_doubtful(checks))


def grouped(lines: Sequence[str]) -> tuple[str, ...]:
    """"name: text" lines; those of one text as one line, that names a few."""
    names: dict[str, list[str]] = {}
    for line in lines:
        name, _, text = line.partition(": ")
        names.setdefault(text, []).append(name)
    return tuple(f"{_names(of, '')}: {text}" if len(of) > 1 else f"{of[0]}: {text}" for text, of in names.items())


def _floor(checks: Checks) -> float:
    """Relative errors of brightness that causes other than lights and exposures make."""
    bounced = 2 * checks.unlit_share if is_indirect(checks.unlit_share) else 0.0
    return max([bounced, *(PER_PIXEL * m.pixels for m in _off(checks))])


def _off(checks: Checks) -> list[Misfit]:
    """Views beside their predictions; not through cameras that see a light which, without doubt, stands elsewhere.

    Its shading pulls at the camera, while a camera that is off explains nothing by lights.
    """
    sure = {light.name for light in checks.lights
            if light.effect > LEAST_MOVE and light.offset_share > LEAST_MOVE and light.explained > SURE}
    excused = {v.camera for v in checks.views if sure & set(v.lights)}
    return [m for m in checks.registration if m.shifted and m.pixels > LEAST_SHIFT and m.camera not in excused]


def _indirect(checks: Checks) -> list[str]:
    if not is_indirect(checks.unlit_share):
        return []
    line = f"{checks.name}: where no light arrives the views show {checks.unlit_share:.1%} of what lit places do; "
    if checks.not_bounced:
        return [f"{line}{checks.not_bounced}, so it was not taken out: subtract the camera's black level, darken the "
                "surroundings, or add what stood around the object to the scene"]
    return [f"{line}bounced light (or a black level) is in them: solve with indirect light 'on', or darken the "
            "surroundings"]


LINEAR = ("not 1; check that they are linear (no sRGB curve, no view transform), their colour space, and that no other "
          "light is in them")


def _curve(checks: Checks) -> list[str]:
    slope = checks.slope
    if not slope:
        return []
    # A curve is the same in all views; lights in wrong places bend each view in its own way.
    scatter = scale_of(np.array([v.slope.exponent for v in checks.views if v.slope]))
    least = max(LEAST_POWER + _floor(checks), _bent(checks))
    if abs(slope.exponent - 1) <= max(least, SIGMAS_POWER * slope.error, scatter):
        return []
    return [f"all views: brightness follows light to the power {slope.exponent:.2f}, {LINEAR}"]


def _bent(checks: Checks) -> float:
    """How far from 1 a material that is not what its model says may move an exponent."""
    return LEAST_POWER_MISFIT if checks.misfit else 0.0


def _curved(checks: Checks) -> dict[str, float]:
    """Exponents of single views that are not linear; one also moves with a light in the wrong place, or a camera."""
    elsewhere = {light.name for light in _moved(checks)}
    off = {m.image.name for m in checks.registration if m.shifted}
    return {v.view: v.slope.exponent for v in checks.views
            if v.slope
            and abs(v.slope.exponent - 1) > max(
                LEAST_POWER_ALONE + _floor(checks), SIGMAS_POWER * v.slope.error, _bent(checks))
            and not elsewhere & set(v.lights) and v.view not in off}


def _curve_of_some(checks: Checks) -> list[str]:
    curved = _curved(checks)
    if not curved:
        return []
    worst = max(curved.values(), key=lambda power: abs(power - 1))
    return [f"{_names(list(curved))}: brightness follows light to the power {worst:.2f}, {LINEAR}"]


def _registration(checks: Checks) -> list[str]:
    off = _off(checks)
    return [f"{_shifted(off)}; check the cameras' calibration, or solve with registration 'auto'"] if off else []


def _shifted(off: Sequence[Misfit]) -> str:
    """Which views lie beside their predictions, and by how much."""
    worst = max(off, key=lambda m: m.pixels)
    where = _names([m.image.name for m in off]) if len(off) <= NAMED else (
        f"{len(off)} views of {_names(sorted({m.camera for m in off}))}")
    x, y = worst.shift
    return f"{where}: {worst.pixels:.2f} pixels off ({x:+.2f}, {y:+.2f} in '{worst.image.name}')"


def mended(checks: Checks, shifts: bool, gains: bool) -> tuple[str, ...]:
    """What a solve put right, given the checks of its first round."""
    off = [m for m in checks.registration if m.shifted and shifts]
    drifted = [m for m in checks.registration if m.drifted and gains]
    lines = [f"{_shifted(off)}; put right"] if off else []
    if drifted:
        worst = max(drifted, key=lambda m: abs(float(np.log(m.gain))))
        lines.append(f"{_names([m.image.name for m in drifted])}: exposure off (by {worst.gain - 1:+.1%} in "
                     f"'{worst.image.name}'); put right")
    return tuple(lines)


def _moved(checks: Checks) -> list[LightResidual]:
    """Lights that belong elsewhere, the worst first."""
    least = max(LEAST_MOVE, _floor(checks))
    found = [light for light in checks.lights
             if light.effect > least and light.offset_share > LEAST_MOVE and light.explained > EXPLAINED]
    return sorted(found, key=lambda light: -light.effect)


def _strong(checks: Checks) -> list[LightResidual]:
    """Lights whose views, two of them at least, are alike too bright or too dark; the worst first."""
    gains = np.log([light.gain for light in checks.lights])
    least = max(LEAST_GAIN, _floor(checks), SIGMAS * scale_of(gains))
    found = [(light, abs(float(gain))) for light, gain in zip(checks.lights, gains, strict=True)
             if light.views >= 2 and abs(gain) > max(least, 4 * light.gain_error)]
    return [light for light, _ in sorted(found, key=lambda pair: -pair[1])]


def _lights(checks: Checks) -> list[str]:
    moved, strong = _moved(checks), _strong(checks)
    if len(moved) > max(NAMED, len(checks.lights) / 2):
        return [f"{len(moved)} of {len(checks.lights)} lights: their shading fits if they stand elsewhere, "
                f"'{moved[0].name}' by {moved[0].offset_share:.0%} of its distance; check place and scale of the "
                "object and of the lights"]
    lines = []
    for light in moved[:NAMED]:
        x, y, z = light.offset
        lines.append(f"light '{light.name}': its shading fits if it stands {np.linalg.norm(light.offset):.2g} m "
                     f"({light.offset_share:.0%} of its distance) elsewhere, by ({x:+.2g}, {y:+.2g}, {z:+.2g}); "
                     f"check its place and size{', and its power' if light in strong else ''}")
    for light in [light for light in strong if light not in moved][:NAMED]:
        off = f"{abs(light.gain - 1):.1%} {'less' if light.gain < 1 else 'more'} light"
        lines.append(f"light '{light.name}': its {light.views} views show {off} than the others explain; "
                     "check its power")
    return lines


def _exposures(checks: Checks) -> list[str]:
    said = {light.name for light in (*_strong(checks), *_moved(checks))}
    curved = _curved(checks)
    rest = [v for v in checks.views if not said & set(v.lights) and v.view not in curved]
    gains = {v.view: v.residual.gain for v in rest}
    least = max([LEAST_GAIN, _floor(checks), *(2 * light.effect for light in _moved(checks))])
    off = {v.view: abs(float(np.log(v.residual.gain))) for v in rest
           if abs(np.log(v.residual.gain)) > max(least, SIGMAS * v.residual.gain_error)}
    if not off:
        return []
    worst = max(off, key=off.__getitem__)
    by = f"{gains[worst] - 1:+.1%} in '{worst}'"
    do = "check exposures and lights' power, or solve with exposures 'solve'"
    if len(off) > max(NAMED, len(rest) / 4):
        drift = scale_of(np.log(list(gains.values())))
        return [f"{len(off)} of {len(checks.views)} views: exposure drifts by {drift:.1%} ({by}); {do}"]
    return [f"{_names(list(off))}: brighter or darker than the others explain ({by}); {do}"]


def _clipped(checks: Checks) -> list[str]:
    if checks.clipped <= CLIPPED:
        return []
    worst = max(checks.views, key=lambda v: v.clipped)
    return [f"{checks.name}: {checks.clipped:.1%} of its pixels are clipped and left out, most in '{worst.view}' "
            f"({worst.clipped:.0%}); highlights are lost: expose less"]


def _unexplained(checks: Checks) -> list[str]:
    lobes, all_of_it = checks.highlight > HIGHLIGHT, checks.structure > max(STRUCTURE, NOISE_SHARE * checks.noise)
    if (lobes or all_of_it) and checks.pixels_per_texel > COARSE:
        return [f"{checks.name}: maps are coarser than the pictures ({checks.pixels_per_texel:.0f} pixels a texel), "
                f"which leaves {max(checks.structure, checks.highlight):.1%} unexplained; solve at a larger size"]
    if lobes:
        return [f"{checks.name}: highlights are off by {checks.highlight:.0%} of their brightness; they have "
                "another strength or shape (try model one-lobe-specular or two-lobe), or a light's size is"]
    if all_of_it:
        worst = max(checks.views, key=lambda v: v.residual.structure)
        return [f"{checks.name}: the maps leave {checks.structure:.1%} of the brightness unexplained, most in "
                f"'{worst.view}' ({worst.residual.structure:.1%}); check the mesh, its normals, lights' sizes and "
                "what else lights the scene"]
    return []


FEWER = {"lambert": "too few to tell a highlight by; take more views",
         "two-lobe": "as model two-lobe needs; take more views, or solve for one-lobe"}


def _few(checks: Checks) -> list[str]:
    return [f"{checks.name}: {m.fewer:.0%} of the solved texels of '{m.material}' have fewer than {m.needed:g} good "
            f"observations (median {m.observations:.0f}), " + FEWER.get(m.model, (
                f"as model {m.model} needs; their roughness leans on their neighbours; take more views"))
            for m in checks.materials if checks.sure and m.needed > 1 and m.fewer > FEW]


def _doubtful(checks: Checks) -> list[str]:
    if not checks.doubtful > DOUBTFUL:
        return []
    near = "nothing of it shone" if math.isinf(checks.nearest) else (
        f"no highlight came near {checks.no_highlight:.0%} of it (nearest: {checks.nearest:.1f} lobe widths, in the "
        f"median) at {checks.noise:.1%} noise")
    return [f"{checks.name}: roughness may be off by more than 0.15 on {checks.doubtful:.0%} of its solved texels: "
            f"{near}; take views with highlights there (see the confidence map)"]


def _names(names: Sequence[str], mark: str = "'") -> str:
    """A few names in one line."""
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return ", ".join(f"{mark}{name}{mark}" for name in names[:NAMED]) + more
