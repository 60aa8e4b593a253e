"""The channels of the solve stage's textures as named arrays: the only place that knows their order."""

from __future__ import annotations

import math
from dataclasses import dataclass

import moderngl
import numpy as np

from ...core.checks.residuals import MAD
from ...core.data import F32, Bool
from ..device.context import Device

INFORMED = 0.05  # standard error of a texel's roughness up to which it shows how texels differ ...
FEW = 50  # ... if so many do
WELL_KNOWN = 0.01  # the same where it can hardly be a false lobe
DOUBT = 2.0  # factor of the texels' own variances, which hold their noise alone


@dataclass(frozen=True)
class Support:
    """What the search of a texel rests on, (h, w) each; second output of solve/search.kernel."""

    curvature: F32  # one lobe: of the residual by roughness; two lobes: share of the observations that are good
    observations: F32  # good ones
    degrees: F32  # of freedom that they leave
    observed: Bool


def read_support(device: Device, texture: moderngl.Texture) -> Support:
    """From the search's second output."""
    curvature, observations, degrees, observed = np.moveaxis(device.read(texture), -1, 0)
    return Support(curvature, observations, degrees, observed > 0.5)


def read_residual(device: Device, best: moderngl.Texture, lobes: int) -> F32:
    """(h, w) weighted sum of squared relative residuals of the best fit, from the search's first output."""
    return np.asarray(device.read(best)[..., 1 if lobes == 1 else 3])


@dataclass(frozen=True)
class SolvedTexels:
    """What the solve stage finds at each texel, (h, w) each."""

    roughness: F32  # perceptual; of two lobes the sharper one's
    sigma: F32  # its standard error; of two lobes the larger one
    determined: F32  # how many numbers the data themselves determined
    solved: Bool
    observations: F32  # good ones
    residual: F32  # weighted sum of their squared relative residuals
    lambert_residual: F32  # the same of the model without a lobe; NaN where that was not fitted
    base_sigma: F32  # standard error of base colour

    def where(self, inside: Bool, other: SolvedTexels) -> SolvedTexels:
        """``other`` inside, these elsewhere; the residuals without a lobe stay these."""
        mixed = {name: np.where(inside, getattr(other, name), values) for name, values in vars(self).items()}
        return SolvedTexels(**mixed | {"lambert_residual": self.lambert_residual})

    def spread(self, texels: Bool, sure: float = INFORMED) -> float:
        """Standard deviation of the roughness of some texels, (h, w), beyond its noise; 0 where few are informed.

        Of those whose standard error is below ``sure``.
        """
        informed = texels & self.solved & (self.sigma < sure)
        if int(informed.sum()) < FEW:
            return 0.0
        own, noise = (of[informed].astype(np.float64) for of in (self.roughness, self.sigma))
        variance = (MAD * float(np.median(np.abs(own - np.median(own))))) ** 2
        return math.sqrt(max(variance - DOUBT * float(np.median(noise**2)), 0.0))


@dataclass(frozen=True)
class RoughnessMaps:
    """The solve stage's textures, on the texel grid; released by the caller."""

    roughness: moderngl.Texture  # roughness, its standard error, numbers that the data determined, solved
    detail: moderngl.Texture  # good observations, residual, residual without lobe, standard error of base colour
    pairs: moderngl.Texture | None = None  # two lobes: roughness1, roughness2, weight of lobe 1, residual

    def read(self, device: Device) -> SolvedTexels:
        """The channels by name."""
        return read_solved(device.read(self.roughness), device.read(self.detail), self.pairs is not None)

    def read_pairs(self, device: Device) -> F32 | None:
        """(h, w, 3) roughness1, roughness2 and the weight of lobe 1; None of one lobe."""
        return None if self.pairs is None else device.read(self.pairs)[..., :3].copy()

    def release(self) -> None:
        """Free the textures."""
        for texture in (self.roughness, self.detail, self.pairs):
            if texture is not None:
                texture.release()


def read_solved(roughness: F32, detail: F32, two_lobes: bool = False) -> SolvedTexels:
    """From the two outputs of solve/polish.kernel, or those of two lobes in their form, (h, w, 4) each."""
    value, sigma, determined, solved = np.moveaxis(roughness, -1, 0)
    observations, residual, lambert, base_sigma = np.moveaxis(detail, -1, 0)
    if two_lobes:  # whose polish counts what the data determined there
        lambert = np.full_like(lambert, np.nan)
    return SolvedTexels(value, sigma, determined, solved > 0.5, observations, residual, lambert, base_sigma)
