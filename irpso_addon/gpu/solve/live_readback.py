"""What kernels have found so far, read back while they go from tile to tile."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import moderngl
import numpy as np

from ...core.data import F32, Bool
from ...core.live_maps import Live
from ...core.observation_quality import HALF_SURE
from ..device.context import Device
from ..observe.observation_atlas import CAMERA_SLACK
from . import neighbours
from .texel_records import read_residual, read_solved, read_support

UNKNOWN = np.float32(np.nan)


def confidence(sigma: F32, observations: F32) -> F32:
    """0 to 1: half where the standard error of roughness is HALF_SURE; nothing from edges of shadow alone."""
    enough = np.clip(0.5 * (observations - 1.0), 0.0, 1.0)
    return np.asarray(enough / (1.0 + (sigma / HALF_SURE) ** 2), np.float32)


def relative_error(residual: F32, observations: F32) -> F32:
    """RMS relative residual of a texel from its sum of squares."""
    return np.asarray(np.sqrt(np.maximum(residual, 0.0) / np.maximum(observations, 0.25)), np.float32)


def _searched(lobes: int, device: Device, outputs: Sequence[moderngl.Texture]) -> Live:
    """Of solve/search.kernel.  With two lobes it does not tell how sure a texel is: confidence is 0 then."""
    support, residual = read_support(device, outputs[1]), read_residual(device, outputs[0], lobes)
    known = support.observed
    if lobes == 1:
        variance = _noise(residual[known], support.degrees[known])
        sure = confidence(np.sqrt(variance / np.maximum(support.curvature, 1e-6)), support.observations)
    else:
        sure = np.zeros_like(residual)
    roughness = device.read(outputs[0])[..., 0]
    return _live(roughness, known, confidence=sure, error=relative_error(residual, support.observations))


def _noise(residual: F32, degrees: F32) -> float:
    """Median variance of the relative noise that fits leave, (N,) each; where none tells, the slack between cameras."""
    informed = neighbours.telling(degrees, tilts=True)
    if not informed.any():
        return CAMERA_SLACK**2
    return max(float(np.median(residual[informed] / degrees[informed])), neighbours.NOISE_FLOOR**2)


def _polished(device: Device, outputs: Sequence[moderngl.Texture]) -> Live:
    """Of solve/polish.kernel."""
    texels = read_solved(device.read(outputs[0]), device.read(outputs[1]))
    return _live(texels.roughness, texels.solved, confidence=confidence(texels.sigma, texels.observations),
                 error=relative_error(texels.residual, texels.observations))


def _polished_two(device: Device, outputs: Sequence[moderngl.Texture]) -> Live:
    """Of solve/polish_two.kernel."""
    pairs, variances, detail = (device.read(texture) for texture in outputs)
    sigma = np.sqrt(np.minimum(variances[..., 2], 0.25))  # the larger one
    return _live(pairs[..., 0], variances[..., 3] > 0.5, confidence=confidence(sigma, detail[..., 0]),
                 error=relative_error(detail[..., 1], detail[..., 0]))


def _live(roughness: F32, known: Bool, **others: F32) -> Live:
    maps = {"roughness": roughness, **others}
    return Live({role: np.where(known, values, UNKNOWN) for role, values in maps.items()})


def base_color(device: Device, texture: moderngl.Texture) -> Live:
    """Of the albedo canvas: RGB and how far pixels showed the texel."""
    values = device.read(texture)
    return Live({"base_color": np.where(values[..., 3:] > 0.25, values[..., :3], UNKNOWN)})


def swarm(best: F32, more: F32) -> Live:
    """Of `paper.PaperMaps`, read back.  The method says nothing of how sure it is."""
    known = more[..., 3] > 0
    live = _live(best[..., 3], known, confidence=np.zeros_like(best[..., 3]),
                 error=np.sqrt(np.maximum(more[..., 2], 0.0)))
    return Live({**live.maps, "base_color": np.where(known[..., None], best[..., :3], UNKNOWN)})


LOOKS: dict[tuple[str, int], Callable[[Device, Sequence[moderngl.Texture]], Live]] = {  # by kernel and lobes
    ("solve/search.kernel", 1): partial(_searched, 1), ("solve/search.kernel", 2): partial(_searched, 2),
    ("solve/polish.kernel", 1): _polished, ("solve/polish_two.kernel", 2): _polished_two}
