"""What a user is told of light and exposures that a solve put right."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from ..change_records import (
    AmbientChange,
    BlackLevelChange,
    Calibration,
    ExposureChange,
    LampChange,
    ResponseChange,
    SizeChange,
    VignettingChange,
    WorldChange,
)
from ..phrases import counted, percent

STAYS = "The scene keeps its lamps and exposures."
MATERIAL = ("That may be the material instead, such as a coat: each view shows the flat object under one angle, "
            "where both look alike. ")
WORLD_STAYS = "The scene keeps its world and the views' turns."


def calibrated(calibration: Calibration | None) -> tuple[str, ...]:
    """The warning line; none where nothing was put right."""
    if calibration is None:
        return ()
    lamps, views = sure_lamps(calibration), sure_exposures(calibration)
    placed = [lamp for lamp in lamps if lamp.sure_place]
    powered = [lamp for lamp in lamps if lamp.sure_power]
    tinted = [lamp for lamp in lamps if lamp.sure_tint]
    parts = [*_sized(calibration.size),
             *_placed([lamp for lamp in placed if not lamp.sun]), *_turned([lamp for lamp in placed if lamp.sun]),
             *_powered(powered, said=powered == placed), *_coloured(tinted), *_exposed(views),
             *_balanced(sure_balances(calibration)),
             *_even(calibration.vignetting), *_surrounded(calibration.ambient), *_straightened(calibration.response),
             *_blackened(calibration.black_level), *_worlds(calibration.worlds)]
    what = " and ".join(filter(None, [", ".join(parts[:-1]), *parts[-1:]]))
    if not parts:
        changed = " and ".join(["lamps"] * bool(calibration.lamps) + ["exposures"] * bool(calibration.exposures)
                               + ["vignetting"] * (calibration.vignetting is not None))
        what = f"changed {changed or 'lamps'} a little, although no single change is certain"
    before, after = (percent(error.relative_rms, 1) for error in (calibration.given, calibration.changed))
    # Few large errors make the root mean square: it may hide that most became smaller.
    smaller = calibration.changed.relative_rms < calibration.given.relative_rms and before != after
    fell = f"The error on left-out views fell from {before} to {after} of their radiance. " if smaller else ""
    doubt = "" if calibration.overlap else MATERIAL
    return (f"IRPSO {what}. {fell}{doubt}{WORLD_STAYS if calibration.worlds else STAYS}",)


def worlds_in_doubt(change: Calibration | None) -> tuple[str, ...]:
    """The line for a change of worlds that was not made; none where there is none."""
    if change is None:
        return ()
    parts = _worlds(change.worlds)
    what = " and ".join(filter(None, [", ".join(parts[:-1]), *parts[-1:]]))
    left = percent(change.changed.relative_rms)
    return (f"all views: would be explained better if IRPSO {what}, but {left} of the radiance of left-out "
            "views would stay unexplained, so it did not; if the worlds may be off by that, enter it and solve again, "
            "otherwise look for what else is wrong (cameras, exposures, the mesh)",)


def sure_lamps(calibration: Calibration) -> list[LampChange]:
    """Lamps of which something is off beyond doubt, those that were moved the farthest first."""
    return sorted((lamp for lamp in calibration.lamps if lamp.sure), key=lambda lamp: -lamp.share)


def sure_exposures(calibration: Calibration) -> list[ExposureChange]:
    """Views whose exposure is off beyond doubt, the worst first."""
    return sorted((view for view in calibration.exposures if view.sure), key=lambda view: -abs(view.stops))


def sure_balances(calibration: Calibration) -> list[ExposureChange]:
    """Views whose white balance is off beyond doubt, the worst first."""
    return sorted((view for view in calibration.exposures if view.sure_tint), key=lambda view: -_most(view.tint))


def lamp_name(lamp: LampChange) -> str:
    """"'Key'", or "the flash on 9 cameras"."""
    return f"the flash on {counted(len(lamp.cameras), 'camera')}" if lamp.cameras else f"'{lamp.lights[0]}'"


def place_change(lamp: LampChange) -> str:
    """"31 ± 2 mm", of a sun "1.2 ± 0.1°"; the error is the root mean square of its parts'."""
    length, error = math.hypot(*lamp.offset), math.hypot(*lamp.offset_error) / math.sqrt(3)
    if lamp.sun:
        return f"{math.degrees(length):.1f} ± {math.degrees(error):.1f}°"
    digits = 0 if length >= 0.01 else 1
    return f"{length * 1000:.{digits}f} ± {error * 1000:.{digits}f} mm"


def power_change(lamp: LampChange) -> str:
    """"× 0.914 ± 0.3%"."""
    return f"× {lamp.power:.3f} ± {percent(lamp.power_error, 1)}"


def tint_change(of: LampChange | ExposureChange) -> str:
    """"RGB × 1.04 1.00 0.96"."""
    return f"RGB × {' '.join(f'{factor:.2f}' for factor in of.tint)}"


def lamp_rows(lamp: LampChange) -> list[tuple[str, str]]:
    """Name and place, power, and color of a lamp, as far as they were changed."""
    name = f"F{lamp_name(lamp).removeprefix('the f')}" if lamp.cameras else lamp.lights[0]
    rows = [(name, "place as given")]
    if lamp.share or lamp.power != 1.0:
        rows = [(name, place_change(lamp)), ("Power", power_change(lamp))]
    if lamp.sure_tint:
        rows += [(channel, f"× {factor:.3f} ± {percent(lamp.tint_error, 1)}")
                 for channel, factor in zip(("Red", "Green", "Blue"), lamp.tint, strict=True)]
    return rows


def exposure_row(calibration: Calibration) -> tuple[str, str, str] | None:
    """"5 Exposures", the largest change, and its view; None: no exposure is off beyond doubt."""
    views = sure_exposures(calibration)
    if not views:
        return None
    most = "up to " if len(views) > 1 else ""
    return counted(len(views), "Exposure"), f"{most}{views[0].stops:+.2f} EV", views[0].image.name


def balance_row(calibration: Calibration) -> tuple[str, str, str] | None:
    """"5 White Balances", the largest change, and its view; None: none is off beyond doubt."""
    views = sure_balances(calibration)
    if not views:
        return None
    most = "up to " if len(views) > 1 else ""
    return counted(len(views), "White Balance"), f"{most}{tint_change(views[0])}", views[0].image.name


def vignetting_row(calibration: Calibration) -> tuple[str, str] | None:
    """"Vignetting", "-0.62 ± 0.03 EV in the corners"; None: it was not changed beyond doubt."""
    found = calibration.vignetting
    if found is None or not found.sure:
        return None
    return "Vignetting", f"{-found.stops:+.2f} ± {abs(found.stops * found.error / found.power):.2f} EV in corners"


def ambient_row(calibration: Calibration) -> tuple[str, str] | None:
    """"Ambient Light", "5.2% ± 0.1% of the lamps'"; None: there is none."""
    found = calibration.ambient
    if found is None:
        return None
    return "Ambient Light", f"{percent(found.share, 1)} ± {percent(found.error, 1)} of the lamps'"


def response_rows(calibration: Calibration) -> list[tuple[str, str]]:
    """"Response", "exponent 0.95 ± 0.001"; of a tone curve also "Shoulder", "8.3 ± 0.2"; none: it was not changed."""
    found = calibration.response
    if found is None:
        return []
    rows = [("Response", f"exponent {found.exponent:.3f} ± {found.exponent * found.error:.3f}")]
    if found.shoulder != 1:
        rows.append(("Shoulder", f"{found.shoulder:.1f} ± {found.shoulder * found.shoulder_error:.1f}"))
    return rows


def black_row(calibration: Calibration) -> tuple[str, str] | None:
    """"Black Level", "0.0020 ± 0.0001"; None: it was not changed."""
    found = calibration.black_level
    return None if found is None else ("Black Level", f"{_grey(found):.2g} ± {found.error:.1g}")


def size_row(calibration: Calibration) -> tuple[str, str] | None:
    """"Lamps' Width", "1.10 ± 0.06 m", of suns "Suns' Angle", "5.1 ± 0.3°"; None: it was not changed."""
    found = calibration.size
    if found is None:
        return None
    return "Suns' Angle" if found.sun else "Lamps' Width", _width(found, 2 * found.error)


def world_rows(calibration: Calibration) -> list[tuple[str, str]]:
    """Name and turn of each world that is off beyond doubt, "'Studio'", "+3.1 ± 0.2°"; a row for its strength."""
    rows = []
    for name, changes in _by_world(calibration.worlds).items():
        turned = [change for change in changes if change.sure_turn]
        if turned:
            worst = max(turned, key=lambda change: abs(change.turn))
            most = "up to " if len(turned) > 1 else ""
            rows.append((name, f"{most}{math.degrees(worst.turn):+.1f} ± {math.degrees(worst.turn_error):.1f}°"))
        if changes[0].sure_strength:
            rows.append((f"Strength of {name}",
                         f"× {changes[0].strength:.3f} ± {percent(changes[0].strength_error, 1)}"))
    return rows


def gain_of(calibration: Calibration) -> str:
    """"4.3% → 3.8%": how far left-out views are off, before and after."""
    return f"{percent(calibration.given.relative_rms, 1)} → {percent(calibration.changed.relative_rms, 1)}"


def _even(found: VignettingChange | None) -> list[str]:
    if found is None or not found.sure:
        return []
    return [f"removed vignetting of {-found.stops:+.2f} EV in the corners"]


def _surrounded(found: AmbientChange | None) -> list[str]:
    if found is None:
        return []
    return [f"subtracted ambient light of {percent(found.share, 1)} of the lamps' irradiance"]


def _straightened(found: ResponseChange | None) -> list[str]:
    if found is None:
        return []
    if found.shoulder != 1:
        return [f"undid a tone curve of exponent {found.exponent:.2f} and shoulder {found.shoulder:.1f}, because the "
                "files have one"]
    return [f"undid a response of exponent {found.exponent:.3f}, because the files are not linear"]


def _blackened(found: BlackLevelChange | None) -> list[str]:
    if found is None:
        return []
    return [f"subtracted a black level of {_grey(found):.2g} from all files"]


def _grey(found: BlackLevelChange) -> float:
    return sum(found.level) / len(found.level)


def _sized(found: SizeChange | None) -> list[str]:
    if found is None:
        return []
    before = replace(found, extent=found.given)
    what = "angle of the suns" if found.sun else "width of the lamps"
    return [f"changed the {what} from {_width(before)} to {_width(found)}"]


def _width(of: SizeChange, error: float | None = None) -> str:
    """"1.10 ± 0.06 m", "48 ± 3 mm", "5.1 ± 0.3°"."""
    width, scale, unit, digits = 2 * of.extent, 1.0, " m", 2
    if of.sun:
        scale, unit, digits = math.degrees(1.0), "°", 1
    elif width < 0.1:
        scale, unit, digits = 1000.0, " mm", 0
    more = "" if error is None else f" ± {scale * error:.{digits}f}"
    return f"{scale * width:.{digits}f}{more}{unit}"


def _placed(lamps: Sequence[LampChange]) -> list[str]:
    if not lamps:
        return []
    worst = lamps[0]
    if len(lamps) == 1:
        return [f"moved {lamp_name(worst)} by {percent(worst.share, 1)} of its distance"]
    return [f"moved {len(lamps)} lamps by up to {percent(worst.share, 1)} of their distance ({lamp_name(worst)})"]


def _turned(suns: Sequence[LampChange]) -> list[str]:
    if not suns:
        return []
    worst = f"{math.degrees(suns[0].share):.1f} degrees"
    if len(suns) == 1:
        return [f"turned {lamp_name(suns[0])} by {worst}"]
    return [f"turned {len(suns)} suns by up to {worst} ({lamp_name(suns[0])})"]


def _powered(lamps: Sequence[LampChange], said: bool) -> list[str]:
    """``said``: whether the sentence has named these lamps already."""
    if not lamps:
        return []
    worst = max(lamps, key=lambda lamp: abs(math.log(lamp.power)))
    if len(lamps) == 1:
        return [f"changed {'its power' if said else f'the power of {lamp_name(worst)}'} by "
                f"{percent(worst.power - 1, 1, sign=True)}"]
    what = "their power" if said else f"the power of {len(lamps)} lamps"
    return [f"changed {what} by up to {percent(worst.power - 1, 1, sign=True)} ({lamp_name(worst)})"]


def _coloured(lamps: Sequence[LampChange]) -> list[str]:
    if not lamps:
        return []
    worst = max(lamps, key=lambda lamp: _most(lamp.tint))
    by = _most_of(worst.tint)
    if len(lamps) == 1:
        return [f"changed the colour of {lamp_name(worst)} by up to {by}"]
    return [f"changed the colours of {len(lamps)} lamps by up to {by} ({lamp_name(worst)})"]


def _exposed(views: Sequence[ExposureChange]) -> list[str]:
    if not views:
        return []
    worst = f"{views[0].stops:+.2f} EV"
    if len(views) == 1:
        return [f"changed the exposure of '{views[0].image.name}' by {worst}"]
    return [f"changed the exposure of {len(views)} views by up to {worst} ('{views[0].image.name}')"]


def _balanced(views: Sequence[ExposureChange]) -> list[str]:
    """``views``: the worst first."""
    if not views:
        return []
    whose = counted(len(views), "view") if len(views) > 1 else f"'{views[0].image.name}'"
    worst = f" ('{views[0].image.name}')" if len(views) > 1 else ""
    return [f"matched the white balance of {whose} to the typical view's, by up to {_most_of(views[0].tint)}{worst}"]


def _most(tint: tuple[float, float, float]) -> float:
    """The largest change of a channel, of its logarithm."""
    return max(abs(math.log(factor)) for factor in tint)


def _most_of(tint: tuple[float, float, float]) -> str:
    """"-6.1 %": the largest change of a channel."""
    return percent(max(tint, key=lambda factor: abs(math.log(factor))) - 1, 1, sign=True)


def _worlds(worlds: Sequence[WorldChange]) -> list[str]:
    parts = []
    for name, changes in _by_world(worlds).items():
        turned = [change for change in changes if change.sure_turn]
        if turned:
            worst = max(turned, key=lambda change: abs(change.turn))
            what = f"{len(turned)} turns of world '{name}' by up to" if len(turned) > 1 else f"world '{name}' by"
            verb = "changed" if len(turned) > 1 else "turned"
            parts.append(f"{verb} {what} {math.degrees(worst.turn):+.1f} degrees")
        if changes[0].sure_strength:
            parts.append(f"changed the strength of world '{name}' by {percent(changes[0].strength - 1, 1, sign=True)}")
    return parts


def _by_world(worlds: Sequence[WorldChange]) -> dict[str, list[WorldChange]]:
    return {name: [change for change in worlds if change.world == name]
            for name in dict.fromkeys(change.world for change in worlds)}
