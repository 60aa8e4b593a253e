"""A sample of texels under the normals that explain its views: so that errors of a mesh do not hide those of lamps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..calibration.rig import Rig, RigChange
from ..calibration.rig_sample import RigSample
from ..calibration.texel_materials import lobes_of, materials_of
from ..data import F64
from .judge import LEAST_TILT, PASSES, large_scale
from .tilt_fit import fit_tilts
from .tilt_sample import LEAST, TiltSample


def straightened(sample: RigSample, change: RigChange | None = None) -> RigSample:
    """The sample as if its mesh had the normals that explain it; itself where the given ones do.

    ``change``: of the rig under which they are sought; None: as it is given.  What the tilts of regions have in common
    is left out, because lamps in the wrong place look like that.
    """
    tilt = _detail(sample if change is None else _under(sample, change))
    if tilt is None:
        return sample
    given = TiltSample.of(sample)
    texels, more = given.tilted(tilt)
    normal = sample.normal + given.offset(tilt)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), LEAST)
    return replace(sample, texels=replace(texels, irradiance=texels.irradiance * more[..., None]), normal=normal)


def _under(sample: RigSample, change: RigChange) -> RigSample:
    """The sample with a changed rig as the given one."""
    lights = sample.rig.lights(change)
    views = [replace(view, lights=tuple(lights[light.name] for light in view.lights)) for view in sample.rig.views]
    return replace(sample, texels=sample.geometry.under(change).texels, rig=Rig.of(views, sample.position.mean(0)))


def _detail(sample: RigSample) -> F64 | None:
    """(T, 2) tilts of the normals; None where they explain the views."""
    tilted, seen, tilt = TiltSample.of(sample), sample.texels, None
    for _ in range(PASSES):
        materials = materials_of(sample, seen, not sample.scale_known)
        found = fit_tilts(tilted, lobes_of(sample, seen, materials), start=tilt)
        if found.deviation() < LEAST_TILT:
            return None
        tilt = found.under(found.deviation())[0]
        seen = tilted.tilted(tilt)[0]
    assert tilt is not None
    return np.asarray(tilt - large_scale(tilted, tilt))
