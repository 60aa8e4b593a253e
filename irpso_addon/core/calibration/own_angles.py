"""Whether a change of lamps and exposures is the material's, where each view shows the object under its own angle.

A left-out view that is predicted at an exposure of its own says nothing of that: its exposure takes up whatever the
material adds under its angle.  As given, it does: what is found in views whose exposures are changed wrongly is no
material's, and predicts it worse.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..data import F64, Bool
from ..evaluation.folds import Folds, Judge
from ..evaluation.joint_material import JointSearch
from ..evaluation.sampled_texels import Lobes, SampledTexels, one_lobe, predicted
from ..job import Progress, Steps
from .rig import RigChange
from .rig_sample import RigSample
from .tints import under_tints

NOTICEABLE = 1.0  # L*
MODELS = "lambert", "plain", "specular", "metal"  # Lambert's, and what `JointSearch.fit` finds of one value for all


def foretells(sample: RigSample, folds: Folds, change: RigChange) -> Steps[bool]:
    """Whether changed views predict left-out views as given, or these are not noticeably worse than from given ones.

    By whichever model predicts best from each.
    """
    given, seen = sample.texels, under_tints(sample, change).geometry.under(change).texels
    judge = Judge(given, folds, sample.cluster)
    for name in ("given", "changed"):
        shown: dict[str, list[F64]] = {model: [] for model in MODELS}
        for left_out in folds.left_out:
            yield Progress(0.0, "calibrate", "the material instead")
            texels = given if name == "given" else _mixed(seen, given, left_out)
            joint = JointSearch(texels).fit(~left_out)
            for model, values in shown.items():
                one = None if model == "lambert" else getattr(joint, model)
                lobes: Lobes | None = None if one is None else one_lobe(
                    np.full(len(texels.cos_v), one.roughness), one.level, one.metallic)
                values.append(predicted(texels, lobes, ~left_out))
        for model, values in shown.items():
            judge.add(f"{name}, {model}", values)
    before, after = (judge.near([f"{name}, {model}" for model in MODELS], 0.0)[0] for name in ("given", "changed"))
    return judge.error(after).lightness <= judge.error(before).lightness + NOTICEABLE


def _mixed(seen: SampledTexels, given: SampledTexels, left_out: Bool) -> SampledTexels:
    """Texels of changed views, of which some are as given."""
    return replace(seen, reflected=np.where(left_out[:, None], given.reflected, seen.reflected),
                   irradiance=np.where(left_out[:, None], given.irradiance, seen.irradiance),
                   lobes=np.where(left_out[:, None, None], given.lobes, seen.lobes))
