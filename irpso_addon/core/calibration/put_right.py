"""A scene with lamps and exposures put right, and what is told of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

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
from ..checks.light_checks import moved
from ..checks.mended_cameras import given_name
from ..data import F64, Environment, SceneData, View
from ..shading.environment import about_z
from ..shading.lights import extent_of, with_extent
from ..vignetting import corner_stops
from .contest import SURE
from .finish import Judged
from .free_numbers import LEAST_CHANGE, sure_of_vignetting
from .rig import Rig, with_factors, with_more
from .rig_sample import COLOURS
from .tints import LEAST_TINT
from .worlds import WorldsJudged

_WHITE = (1.0, 1.0, 1.0)


def put_right(scene: SceneData, rig: Rig, judged: Judged) -> SceneData:
    """The scene after the change; views that the rig does not have keep their exposure."""
    change = judged.found.change
    lights = rig.lights(change)
    gains = {(view.image, view.camera.name): float(np.exp(gain))
             for view, gain in zip(rig.views, change.log_gain, strict=True)}
    tints = {} if change.log_balance is None else {
        (view.image, view.camera.name): np.exp(by) for view, by in zip(rig.views, change.log_balance, strict=True)}
    return replace(scene, views=tuple(
        replace(view, lights=tuple(lights.get(light.name, light) for light in view.lights),
                gain=view.gain * gains.get((view.image, view.camera.name), 1.0),
                tint=with_factors(view.tint, tints.get((view.image, view.camera.name), _WHITE)),
                vignetting=view.vignetting + change.vignetting,
                response=view.response * float(np.exp(change.log_response)),
                shoulder=view.shoulder * float(np.exp(change.log_shoulder)),
                black_level=_raised(view, (0.0, 0.0, 0.0) if change.black_level is None else change.black_level),
                ambient_radiance=_brightened(view, judged.ambient_radiance)) for view in scene.views))


def applied(scene: SceneData, calibration: Calibration) -> SceneData:
    """The scene after a change that an earlier solve of it has made."""
    given = {light.name: light for view in scene.views for light in view.lights}
    cameras = {given_name(view): view.camera for view in scene.views}
    size = calibration.size
    if size is not None:
        given |= {name: with_extent(given[name], size.extent) for name in size.lights if name in given}
    lights = {} if size is None else {name: given[name] for name in size.lights if name in given}
    for lamp in calibration.lamps:
        for name, carried in zip(lamp.lights, lamp.cameras or (None,) * len(lamp.lights), strict=True):
            if name in given and (carried is None or carried in cameras):
                axes = np.eye(3) if carried is None else cameras[carried].world_to_camera[:3, :3].T
                light = given[name]
                for axis, by in enumerate(axes @ lamp.offset):
                    light = moved(light, axis, float(by)) if by else light
                lights[name] = replace(light, power=light.power * lamp.power * np.array(lamp.tint))
    gains = {(view.image, view.camera): 2.0**view.stops for view in calibration.exposures}
    tints = {(view.image, view.camera): view.tint for view in calibration.exposures}
    darker = 0.0 if calibration.vignetting is None else calibration.vignetting.power
    exponent, shoulder = (1.0, 1.0) if calibration.response is None else (
        calibration.response.exponent, calibration.response.shoulder)
    black = (0.0, 0.0, 0.0) if calibration.black_level is None else calibration.black_level.level
    around = (0.0, 0.0, 0.0) if calibration.ambient is None else calibration.ambient.radiance
    return replace(scene, views=tuple(
        replace(view, lights=tuple(lights.get(light.name, light) for light in view.lights),
                gain=view.gain * gains.get((view.image, given_name(view)), 1.0),
                tint=with_factors(view.tint, tints.get((view.image, given_name(view)), _WHITE)),
                vignetting=view.vignetting + darker, response=view.response * exponent,
                shoulder=view.shoulder * shoulder,
                black_level=_raised(view, black), ambient_radiance=_brightened(view, around),
                environment=_turned(view.environment, calibration.worlds)) for view in scene.views))


def under_worlds(scene: SceneData, worlds: tuple[WorldChange, ...]) -> SceneData:
    """The scene after a change of its worlds."""
    return replace(scene, views=tuple(
        replace(view, environment=_turned(view.environment, worlds)) for view in scene.views))


def _turned(environment: Environment | None, worlds: tuple[WorldChange, ...]) -> Environment | None:
    for change in worlds if environment is not None else ():
        if environment is not None and environment.world == (change.world, change.given):
            return replace(environment, radiance=environment.radiance * np.float32(change.strength),
                           rotation=environment.rotation @ about_z(change.turn), turn=environment.turn + change.turn)
    return environment


def _brightened(view: View, by: tuple[float, float, float]) -> tuple[float, float, float]:
    """The ambient light of a view after a change; none where a picture without lamps has been subtracted."""
    return view.ambient_radiance if view.ambient is not None else with_more(view.ambient_radiance, by)


def _raised(view: View, by: Sequence[float] | F64) -> tuple[float, float, float]:
    """The black level of a view after a change; none where a picture has been subtracted that has it too."""
    return view.black_level if view.ambient is not None else with_more(view.black_level, by)


def told(rig: Rig, judged: Judged) -> Calibration:
    """All that was changed, and which of it is beyond doubt."""
    change, error = judged.found.change, judged.error
    lamps = []
    shape = change.offset.shape
    tint, tint_error = (np.zeros(shape) if each.log_tint is None else each.log_tint for each in (change, error))
    for n, group in enumerate(rig.groups):
        if not change.offset[n].any() and not change.log_power[n] and not tint[n].any():
            continue
        moves = np.abs(change.offset[n]) > np.maximum(SURE * error.offset[n], LEAST_CHANGE)
        lamps.append(LampChange(
            group.lights, _three(change.offset[n] * group.reach), _three(error.offset[n] * group.reach),
            float(np.linalg.norm(change.offset[n])), float(np.exp(change.log_power[n])), float(error.log_power[n]),
            group.cameras, group.sun, bool(moves.any()),
            bool(abs(change.log_power[n]) > max(SURE * error.log_power[n], LEAST_CHANGE)),
            _three(np.exp(tint[n])), float(tint_error[n].max()),
            bool(np.abs(tint[n]).max() > max(SURE * tint_error[n].max(), LEAST_TINT))))
    views = (len(rig.views), COLOURS)
    tint, tint_error = (np.zeros(views) if each.log_balance is None else each.log_balance for each in (change, error))
    exposures = tuple(
        ExposureChange(view.image, given_name(view), float(gain / np.log(2)), float(sigma / np.log(2)),
                       bool(abs(gain) > max(SURE * sigma, LEAST_CHANGE)), _three(np.exp(by)), float(of.max()),
                       bool(np.abs(by).max() > max(SURE * of.max(), LEAST_TINT)))
        for view, gain, sigma, by, of in zip(
            rig.views, change.log_gain, error.log_gain, tint, tint_error, strict=True) if gain or by.any())
    cameras = [view.camera for view in rig.views]
    vignetting = None if not change.vignetting else VignettingChange(
        change.vignetting, error.vignetting, corner_stops(cameras, change.vignetting), sure_of_vignetting(judged.found))
    ambient = AmbientChange(judged.ambient_radiance, change.ambient, error.ambient) if change.ambient else None
    response = None if not (change.log_response or change.log_shoulder) else ResponseChange(
        float(np.exp(change.log_response)), error.log_response, float(np.exp(change.log_shoulder)), error.log_shoulder)
    black = None if change.black_level is None or error.black_level is None else BlackLevelChange(
        _three(change.black_level), float(error.black_level.max()))
    return Calibration(tuple(lamps), exposures, judged.given, judged.changed, vignetting, ambient, response, black,
                       _resized(rig, change.extent, error.extent), overlap=judged.overlap)


def _resized(rig: Rig, extent: float | None, error: float | None) -> SizeChange | None:
    if extent is None or error is None:
        return None
    lights = {light.name: light for view in rig.views for light in view.lights}
    first = next(iter(lights.values()))
    return SizeChange(tuple(lights), extent, error, extent_of(first), first.kind == "SUN")


def _three(values: F64) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z


def told_of_worlds(judged: WorldsJudged) -> Calibration:
    """All that was changed of worlds, and which of it is beyond doubt."""
    change, error = judged.change, judged.error
    names = list(dict.fromkeys(name for name, _ in judged.keys))
    changes = []
    for k, (name, given) in enumerate(judged.keys):
        w = names.index(name)
        changes.append(WorldChange(
            name, given, float(change.turn[k]), float(error.turn[k]), float(np.exp(change.log_strength[w])),
            float(error.log_strength[w]), judged.sure_turns[k], judged.sure_strengths[w]))
    return Calibration((), (), judged.given, judged.changed, worlds=tuple(changes))
