"""A problem put right as the product puts scenes right: lamps, exposures, ambient light, and the files' response."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from irpso_addon.core.calibration.calibrate import calibrate
from irpso_addon.core.calibration.finish import Judged
from irpso_addon.core.calibration.rig import Rig
from irpso_addon.core.calibration.rig_sample import RigSample, typical_light
from irpso_addon.core.data import F64, Camera, Light, View
from irpso_addon.core.evaluation.sampled_texels import SampledTexels
from studies.bench.opengl import result

from .problem import Geometry, Problem, observed_again

CELLS = 12  # across the patch: texels of a cell err alike, as in irpso_addon/gpu/solve/calibration_sample.py


def righted(problem: Problem) -> Problem:
    """The problem under the geometry and the radiance that predict left-out views better; else as it is."""
    sample = rig_sample(problem)
    judged: Judged | None = result(calibrate(sample, lamps=True, exposures=True))
    return problem if judged is None else _changed(problem, sample, judged)


def rig_sample(problem: Problem) -> RigSample:
    """All texels of a problem."""
    believed, shape = problem.believed, problem.quality.shape[:2]
    count, views = shape[0] * shape[1], problem.trial.views

    def flat(values: F64) -> F64:
        return values.reshape(count, *values.shape[2:]).astype(np.float64)

    numbers = np.arange(views, dtype=np.int32)
    texels = SampledTexels(
        flat(problem.rgb), flat(problem.quality), flat(problem.cos_v), flat(problem.lobes), flat(problem.irradiance),
        np.array(problem.groups, np.int32), 0 * numbers, numbers)
    place = flat(believed.place)
    rig = Rig.of([_view(believed, k, problem.groups[k]) for k in range(views)], place.mean(0))
    row, column = np.divmod(np.arange(count), shape[1])
    cells = row * CELLS // shape[0] * CELLS + column * CELLS // shape[1]
    return RigSample(texels, rig, numbers, place, flat(believed.normal), 0 * cells.astype(np.int32),
                     cells.astype(np.int32), light=typical_light(texels))


def _view(believed: Geometry, k: int, camera: int) -> View:
    place, lamp = np.eye(4), np.eye(4)
    lamp[:3, 3] = believed.lamps[k]
    forward = -believed.cameras[camera] / np.linalg.norm(believed.cameras[camera])
    through = Camera(f"Camera {camera}", place, place, believed.cameras[camera], forward, False, 1.0)
    return View(Path(f"{k}.exr"), through, (Light(f"Lamp {k}", "POINT", believed.power[k], lamp),))


def _changed(problem: Problem, sample: RigSample, judged: Judged) -> Problem:
    change, believed = judged.found.change, problem.believed
    lights = sample.rig.lights(change).values()
    gains = np.exp(change.log_gain)[:, None]
    changed = replace(believed, lamps=np.stack([light.matrix[:3, 3] for light in lights]),
                      power=np.stack([light.power for light in lights]) * gains)
    radiance = np.sign(problem.radiance) * np.abs(problem.radiance) ** np.exp(-change.log_response)
    return observed_again(problem, changed, radiance, change.ambient * sample.light)
