"""From what was measured to what a user is told: a line for each cause, with its number, its name, and what to do.

A cause has many symptoms: a picture that is not linear is too bright here and too dark there, as under a lamp in the
wrong place; bounced light and a camera that is off make errors of every kind.  What explains the most is said, and the
errors that it makes do not count against others (``_floor``).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path

import numpy as np

from ..check_records import Checks, LightResidual, Misfit, Residual, ViewCheck
from ..images.raw_reader import is_raw
from ..params import choice_name
from ..phrases import NAMED, percent, some
from .residuals import is_indirect, scale_of
from .solve_checks import CONTRADICTORY

LEAST_GAIN, LEAST_MOVE = 0.015, 0.01  # relative errors of brightness, of shading, below which nothing is said
EXPLAINED, SURE = 0.25, 0.7  # of the residual's variance that a light's move must explain; of a misfit, or to be sure
LEAST_POWER, LEAST_POWER_ALONE = 0.02, 0.1  # how far from 1 an exponent must be: of all views, of one
BOUNCED_POWER = 0.1  # below 1, up to which bounced light that was left in the pictures explains it
# The same where a material is not what its model says, which bends brightness too: by up to six times what neighbouring
# pixels share of its errors.  Beyond MOST it is a curve: that of sRGB makes 0.5, or 2 where it was undone and is not
# there.  As a ratio, both are as far from 1: highlights of glitter under a flash make 1.6.
LEAST_POWER_MISFIT, BENDS, MOST_POWER_MISFIT = 0.3, 6.0, (0.55, 1 / 0.55)
LEAST_GAIN_MISFIT, SHARED = 0.03, 2.0  # of LEAST_GAIN there: what it lacks makes whole views brighter; times structure
STANDS_OUT = 3.0  # times the median light's: the effect of one that stands elsewhere, where a material is no model
MISFIT_STRUCTURE = 0.03  # relative errors that neighbours share in most views: then a single one proves little
SIGMAS, SIGMAS_POWER = 6.0, 3.0
LEAST_SHIFT = 0.1  # pixels
PER_PIXEL = 0.05  # relative error of brightness that a pixel of misregistration makes
CLIPPED = 0.01  # of the object's pixels
STRUCTURE, NOISE_SHARE = 0.004, 0.3  # relative errors that neighbouring pixels share, and beside the noise
HIGHLIGHT = 0.06  # such errors of highlights, relative to the lobes
COARSE = 2.0  # pixels a texel from which on maps cannot show what the pictures do
FEW = 0.15  # of a material's texels
LET_THROUGH = 0.02  # brightness of shadows, of lit areas, from which on light may have come through the object
CONTRADICTED = 0.01  # of the solved texels
KNOWN = 0.2  # of the texels, below which light from all around says too little of roughness
DOUBTFUL = 0.05  # of the texels are off by more than 0.15, by their own standard errors


def warnings(checks: Checks, tried: Collection[str] = ()) -> tuple[str, ...]:
    """What a user must know, the likeliest cause first; nothing where all is well.

    ``tried``: settings by which the solve has looked for a remedy itself, which no line recommends then.
    """
    curve = _curve(checks, "indirect" in tried)
    causes = [*_indirect(checks, "indirect" in tried), *curve, *_registration(checks, "registration" in tried)]
    if not curve:  # else its errors are of every kind
        causes += [*_curve_of_some(checks), *_lights(checks), *_exposures(checks, "exposures" in tried)]
    return (*causes, *_clipped(checks), *([] if causes else _unexplained(checks, "model" in tried)),
            *_contradicted(checks), *_few(checks), *_doubtful(checks))


def grouped(lines: Sequence[str]) -> tuple[str, ...]:
    """"name: text" lines; those of one text as one line, that names a few."""
    names: dict[str, list[str]] = {}
    for line in lines:
        name, _, text = line.partition(": ")
        names.setdefault(text, []).append(name)
    return tuple(f"{some(of, '')}: {text}" if len(of) > 1 else f"{of[0]}: {text}" for text, of in names.items())


def _floor(checks: Checks) -> float:
    """Relative errors of brightness that causes other than lights and exposures make."""
    bounced = 2 * checks.unlit_share if is_indirect(checks.unlit_share) else 0.0
    return max([bounced, *(PER_PIXEL * m.pixels for m in off_cameras(checks))])


def off_cameras(checks: Checks) -> list[Misfit]:
    """Views beside their predictions; not through cameras that see a light which, without doubt, stands elsewhere.

    Its shading pulls at the camera, while a camera that is off explains nothing by lights.
    """
    sure = {light.name for light in checks.lights
            if light.effect > LEAST_MOVE and light.offset_share > LEAST_MOVE and light.explained > SURE}
    excused = {v.camera for v in checks.views if sure & set(v.lights)}
    return [m for m in checks.registration if m.shifted and m.pixels > LEAST_SHIFT and m.camera not in excused]


def _indirect(checks: Checks, tried: bool) -> list[str]:
    if not is_indirect(checks.unlit_share):
        return []
    line = (f"{checks.name}: shadows are {percent(checks.unlit_share, 1)} as bright as lit areas: bounced light or a "
            "black level; ")
    if checks.not_bounced or tried:
        why = ("IRPSO has subtracted the light that the scene's surfaces bounce" if tried else
               f"IRPSO did not remove it, because {checks.not_bounced}")
        line = (f"{line}{why}; subtract the camera's black level, darken the surroundings, or add what stood around "
                "the object to the scene")
        through = "; a translucent object looks like that too, and IRPSO cannot solve for its material"
        return [line + (through if checks.unlit_share > LET_THROUGH else "")]
    return [f"{line}set Indirect Light to On, or darken the surroundings"]


LINEAR = ("check their colour space, that they have no tone curve or view transform (JPEG files of cameras have one: "
          "use RAW files), and that no other light shone on the object")
LINEAR_RAW = ("RAW files are linear, so either other light shone on the object, a black level is left, or no model "
              "describes the material; shut out other light, or subtract pictures without the lamps")


def all_raw(views: Iterable[str]) -> bool:
    """Of names of pictures."""
    return all(is_raw(Path(view)) for view in views)


def _advice(views: Iterable[str]) -> str:
    return LINEAR_RAW if all_raw(views) else LINEAR


def curved_exponent(checks: Checks) -> float | None:
    """Of all views together, where brightness does not follow light; else None."""
    slope = checks.slope
    if not slope:
        return None
    # A curve is the same in all views; lights in wrong places bend each view in its own way.
    scatter = scale_of(np.array([v.slope.exponent for v in checks.views if v.slope]))
    least = max(LEAST_POWER + _floor(checks), _bent(checks, slope.exponent))
    return None if abs(slope.exponent - 1) <= max(least, SIGMAS_POWER * slope.error, scatter) else slope.exponent


def _curve(checks: Checks, bounced: bool) -> list[str]:
    """``bounced``: whether indirect light was subtracted; under a world no shadow shows that it is there."""
    exponent = curved_exponent(checks)
    if exponent is not None and checks.around and not (bounced or checks.not_bounced) and (
            1 - BOUNCED_POWER < exponent < 1):
        return [f"all views: dark places are brighter than predicted (exponent {exponent:.2f}), as where light bounces "
                "between surfaces; set Indirect Light to On, or use RAW files if these have a tone curve"]
    if exponent is None:
        return []
    line = f"all views: look non-linear (exponent {exponent:.2f}); {_advice(v.view for v in checks.views)}"
    if all_raw(v.view for v in checks.views):
        return [line]
    return [f"{line}; without linear files, multiply the views' Response by {exponent:.2f}"]


def _bent(checks: Checks, exponent: float, misfit: bool = False) -> float:
    """How far from 1 a material that is not what its model says may move an exponent that lies on this side of 1.

    ``misfit``: it is not, whatever the checks say.
    """
    if not (checks.misfit or misfit):
        return 0.0
    least, most = MOST_POWER_MISFIT
    return min(max(LEAST_POWER_MISFIT, BENDS * checks.structure), 1 - least if exponent < 1 else most - 1)


def _curved(checks: Checks) -> dict[str, float]:
    """Exponents of single views that are not linear; one also moves with a light in the wrong place, or a camera."""
    elsewhere = {light.name for light in moved_lights(checks)}
    off = {m.image.name for m in checks.registration if m.shifted}
    # Shapes and shadows that the scene lacks, and materials that are not their models, scatter the exponents of all and
    # leave structure in all views.
    misfit = checks.structure > MISFIT_STRUCTURE
    exponents = np.array([v.slope.exponent for v in checks.views if v.slope])
    scatter, typical = SIGMAS * scale_of(exponents), float(np.median(exponents)) if len(exponents) else 1.0
    return {v.view: v.slope.exponent for v in checks.views
            if v.slope
            and abs(v.slope.exponent - 1) > max(
                LEAST_POWER_ALONE + _floor(checks), SIGMAS_POWER * v.slope.error,
                _bent(checks, v.slope.exponent, misfit), scatter)
            and abs(v.slope.exponent - typical) > scatter
            and not elsewhere & set(v.lights) and v.view not in off}


def _curve_of_some(checks: Checks) -> list[str]:
    curved = _curved(checks)
    if not curved:
        return []
    worst = max(curved.values(), key=lambda power: abs(power - 1))
    return [f"{some(list(curved))}: looks non-linear (exponent {worst:.2f}); {_advice(curved)}"]


def _registration(checks: Checks, tried: bool) -> list[str]:
    off = off_cameras(checks)
    other = "" if tried else ", or set Camera Alignment to Auto"
    return [f"{_shifted(off)}; check the cameras' calibration{other}"] if off else []


def _shifted(off: Sequence[Misfit]) -> str:
    """Which views are off from their predictions, and by how much."""
    worst = max(off, key=lambda m: m.pixels)
    where = some([m.image.name for m in off]) if len(off) <= NAMED else (
        f"{len(off)} views of {some(sorted({m.camera for m in off}))}")
    x, y = worst.shift
    return f"{where}: {worst.pixels:.2f} pixels off ({x:+.2f}, {y:+.2f} in '{worst.image.name}')"


def mended(gains: Sequence[Misfit]) -> tuple[str, ...]:
    """What a solve put right of exposures, given the checks of its first round."""
    drifted = [m for m in gains if m.drifted]
    if not drifted:
        return ()
    worst = max(drifted, key=lambda m: abs(float(np.log(m.gain))))
    return (f"{some([m.image.name for m in drifted])}: exposure off (by {percent(worst.gain - 1, 1, sign=True)} in "
            f"'{worst.image.name}'); corrected",)


def moved_lights(checks: Checks) -> list[LightResidual]:
    """Lights that belong elsewhere, the worst first.

    A material that is not what its model says makes many lights seem to stand elsewhere: one that does stands out.
    """
    least, enough = max(LEAST_MOVE, _floor(checks)), SURE if checks.misfit else EXPLAINED
    found = [light for light in checks.lights
             if light.effect > least and light.offset_share > LEAST_MOVE and light.explained > enough]
    if checks.misfit and 0 < len(found) <= _most(checks):
        least = STANDS_OUT * float(np.median([light.effect for light in checks.lights]))
        found = [light for light in found if light.effect > least]
    return sorted(found, key=lambda light: -light.effect)


def object_moved(checks: Checks) -> bool:
    """Whether so many lights belong elsewhere that the object itself is likelier to."""
    return len(moved_lights(checks)) > _most(checks)


def _most(checks: Checks) -> float:
    """Lights that may each be named; if more seem to stand elsewhere, the object does."""
    return max(NAMED, len(checks.lights) / 2)


def strong_lights(checks: Checks) -> list[LightResidual]:
    """Lights whose views, two of them at least, are alike too bright or too dark; the worst first."""
    gains = np.log([light.gain for light in checks.lights])
    least = max(LEAST_GAIN, _floor(checks), SIGMAS * scale_of(gains))
    found = [(light, abs(float(gain))) for light, gain in zip(checks.lights, gains, strict=True)
             if light.views >= 2 and abs(gain) > max(least, 4 * light.gain_error)]
    return [light for light, _ in sorted(found, key=lambda pair: -pair[1])]


def _lights(checks: Checks) -> list[str]:
    moved, strong = moved_lights(checks), strong_lights(checks)
    if object_moved(checks):
        return [f"{len(moved)} of {len(checks.lights)} lights: they appear elsewhere than the scene has them, "
                f"'{moved[0].name}' by {percent(moved[0].offset_share)} of its distance; check place and scale of the "
                "object and of the lights"]
    lines = []
    for light in moved[:NAMED]:
        power = ", and its power" if light in strong else ""
        if light.sun:
            lines.append(f"light '{light.name}': it appears turned by {math.degrees(light.offset_share):.1f} degrees "
                         f"from where the scene has it; check its direction and angle{power}")
            continue
        x, y, z = light.offset
        lines.append(f"light '{light.name}': it appears {np.linalg.norm(light.offset):.2g} m "
                     f"({percent(light.offset_share)} of its distance) from where the scene has it, at "
                     f"({x:+.2g}, {y:+.2g}, {z:+.2g}) from there; check its place and size{power}")
    for light in [light for light in strong if light not in moved][:NAMED]:
        off = f"{percent(abs(light.gain - 1), 1)} {'darker' if light.gain < 1 else 'brighter'}"
        lines.append(f"light '{light.name}': its {light.views} views are {off} than the other views predict; "
                     "check its power")
    return lines


def drifting(checks: Checks) -> dict[str, float]:
    """Views that are brighter or darker than the others explain: how much, as the logarithm of their gain.

    A gain is a median: under noise of a path tracer, few of whose samples are bright, it lies below the mean by about
    the square of the noise.
    """
    least = max([LEAST_GAIN, _floor(checks), *(2 * light.effect for light in moved_lights(checks))])
    found = {v.view: v.residual for v in _without_cause(checks)}
    gains = {view: float(np.log(residual.gain)) for view, residual in found.items()}
    return {view: gain for view, gain in gains.items()
            if abs(gain) > max(least, _bent_gain(checks, found[view]), SIGMAS * found[view].gain_error,
                               found[view].noise**2)}


def _bent_gain(checks: Checks, seen: Residual) -> float:
    """How much brighter or darker a material that is not what its model says may make a whole view.

    What the model lacks depends on the lamp: a view may lack more than most.
    """
    return max(LEAST_GAIN_MISFIT, SHARED * max(checks.structure, seen.structure)) if checks.misfit else 0.0


def _without_cause(checks: Checks) -> list[ViewCheck]:
    """Views that no curve, and no light's power or place, is said to spoil."""
    said = {light.name for light in (*strong_lights(checks), *moved_lights(checks))}
    curved = _curved(checks)
    return [v for v in checks.views if not said & set(v.lights) and v.view not in curved]


def _exposures(checks: Checks, tried: bool) -> list[str]:
    off = drifting(checks)
    if not off:
        return []
    rest = [v.residual.gain for v in _without_cause(checks)]
    worst = max(off, key=lambda view: abs(off[view]))
    by = f"{percent(float(np.exp(off[worst])) - 1, 1, sign=True)} in '{worst}'"
    do = "check exposures and lights' power" + ("" if tried else ", or set Exposures to Solve")
    if len(off) > max(NAMED, len(rest) / 4):
        drift = scale_of(np.log(rest))
        return [f"{len(off)} of {len(checks.views)} views: exposure drifts by {percent(drift, 1)} ({by}); {do}"]
    return [f"{some(list(off))}: brighter or darker than the other views predict ({by}); {do}"]


def _clipped(checks: Checks) -> list[str]:
    if checks.clipped <= CLIPPED:
        return []
    worst = max(checks.views, key=lambda v: v.clipped)
    return [f"{checks.name}: {percent(checks.clipped, 1)} of its pixels are clipped and left out, most in "
            f"'{worst.view}' ({percent(worst.clipped)}), so highlights are lost; expose less"]


def _unexplained(checks: Checks, tried: bool) -> list[str]:
    lobes, all_of_it = checks.highlight > HIGHLIGHT, checks.structure > max(STRUCTURE, NOISE_SHARE * checks.noise)
    if (lobes or all_of_it) and checks.pixels_per_texel > COARSE:
        return [f"{checks.name}: the maps are coarser than the pictures ({checks.pixels_per_texel:.0f} pixels per "
                f"texel), which leaves {percent(max(checks.structure, checks.highlight), 1)} of the brightness "
                "unexplained; increase Size"]
    one_value = [material for material in checks.materials if material.one_value]
    if lobes and one_value:
        models = " or ".join(dict.fromkeys(choice_name(material.model) for material in one_value))
        return [f"{checks.name}: highlights are off by {percent(checks.highlight)} of their brightness, and IRPSO took "
                f"one roughness for {some([material.material for material in one_value])}; if it differs from place to "
                f"place, set Model to {models}, else check the lights' sizes and the mesh's normals"]
    if lobes:
        used = {material.model for material in checks.materials}
        others = [] if tried else [choice_name(model) for model in LARGER if model not in used]
        return [f"{checks.name}: highlights are off by {percent(checks.highlight)} of their brightness; check the "
                + (f"lights' sizes, or set Model to {' or '.join(others)}" if others else
                   "lights' sizes and the mesh's normals")]
    if all_of_it:
        worst = max(checks.views, key=lambda v: v.residual.structure)
        return [f"{checks.name}: the maps leave {percent(checks.structure, 1)} of the brightness unexplained, most in "
                f"'{worst.view}' ({percent(worst.residual.structure, 1)}); check the mesh, its normals, lights' sizes "
                "and what else lights the scene"]
    return []


def _contradicted(checks: Checks) -> list[str]:
    if not checks.contradicted > CONTRADICTED:
        return []
    return [f"{checks.name}: the views of {percent(checks.contradicted, 1)} of its solved texels contradict each other "
            f"by more than {percent(CONTRADICTORY)}: the mesh casts other shadows there than the object, has another "
            "shape, or has parts smaller than a pixel (their confidence is 0, and the map Error shows where they are); "
            "mend the mesh, add what casts the shadows to the scene, take larger or nearer pictures, or mask these "
            "places out of the pictures"]


LIT = "add a lamp (such as a flash on the camera), a turn of the object or a world with small lights"
LARGER = ("one-lobe-specular", "two-lobe")
FEWER = {"lambert": "too few to detect a highlight; {add}",
         "two-lobe": f"too few for this model; {{add}}, or set Model to {choice_name('one-lobe')}"}
FEW_OF_ANY = "too few for this model, so their roughness comes mostly from their neighbours; {add}"


def _few(checks: Checks) -> list[str]:
    return [f"{checks.name}: {percent(m.fewer)} of the solved texels of '{m.material}' have fewer than {m.needed:g} "
            f"good observations (median {m.observations:.0f}), "
            + FEWER.get(m.model, FEW_OF_ANY).format(add=LIT if _shows_little(checks, m.model) else "take more views")
            for m in checks.materials if checks.sure and m.needed > 1 and m.fewer > FEW]


def _shows_little(checks: Checks, model: str) -> bool:
    """Whether light from all around tells of roughness almost nowhere: further views of it do not either."""
    return checks.around and checks.sure and (model == "lambert" or checks.known < KNOWN)


def _doubtful(checks: Checks) -> list[str]:
    if not checks.doubtful > DOUBTFUL:
        glossy = next((m.model for m in checks.materials if m.model != "lambert"), "")
        line = (f"{checks.name}: confidence is below one half on {percent(1 - checks.known)} of its solved texels: "
                f"light from worlds or glowing meshes shows too little of their roughness; {LIT}")
        return [line] * bool(glossy and _shows_little(checks, glossy))
    line = f"{checks.name}: roughness may be off by more than 0.15 on {percent(checks.doubtful)} of its solved texels"
    if checks.nearest == 0:  # light from all around
        return [f"{line}: light from worlds or glowing meshes shows too little of it at {percent(checks.noise, 1)} "
                f"noise; {LIT}"]
    near = "no view shows a highlight on them" if math.isinf(checks.nearest) else (
        f"no highlight came near {percent(checks.no_highlight)} of the object (median distance of the nearest: "
        f"{checks.nearest:.1f} highlight widths) at {percent(checks.noise, 1)} noise")
    return [f"{line}: {near}; take views with highlights where the confidence map is dark"]
