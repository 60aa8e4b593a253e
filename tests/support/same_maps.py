"""Maps that neither Python nor NumPy nor OpenGL's version may change: saved by each of CI's two, and compared.

    python -m tests.support.same_maps save FILE.npz
    python -m tests.support.same_maps compare FILE.npz FILE.npz

Because they are the same, tests of how right maps are run on one Python alone (.ci/run).
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import fields, replace
from functools import partial
from pathlib import Path

import numpy as np

from irpso_addon.core.data import Coat
from irpso_addon.core.shading import brdf
from tests.support import shoots
from tests.support import synthetic as syn

APART, SHARE = 1e-4, 0.999  # so many values of each map differ by no more; on one machine all are equal, bit for bit
LACQUER = replace(syn.PATCHES, reflect=partial(brdf.principled, level=0.8))
METAL = replace(syn.PATCHES, reflect=partial(brdf.principled, metallic=0.5, coat=Coat(0.6, 0.25)))
MATT = replace(syn.PATCHES, reflect=partial(brdf.principled, diffuse_roughness=0.6))
SOLVES = {
    "auto": (syn.PATCHES, {}), "swarm": (syn.PATCHES, {"method": "swarm", "model": "one-lobe"}),
    "put right": (LACQUER, {"lamps": "auto", "exposures": "auto"}),
    "two lobes": (LACQUER, {"model": "two-lobe", "size": 32}), "metal under a coat": (METAL, {}),
    "rough diffuse": (MATT, {}),
    "paper": (syn.PATCHES, {"method": "paper", "iterations": 40, "normals": "auto"}),
}


def solves() -> Iterator[tuple[str, np.ndarray]]:
    """Every map of every solve, by "solve: map"."""
    for name, (truth, settings) in SOLVES.items():
        maps = shoots.run(syn.shoot(truth, shoots.rig(), (56, 56)), **settings).maps
        for field in fields(maps):
            values = getattr(maps, field.name)
            if isinstance(values, np.ndarray):
                yield f"{name}: {field.name}", values.astype(np.float32)


def differences(first: dict[str, np.ndarray], second: dict[str, np.ndarray]) -> list[str]:
    """One line for each map that is not the same."""
    told = [f"{name}: in one of them only" for name in sorted(first.keys() ^ second.keys())]
    for name in sorted(first.keys() & second.keys()):
        one, other = first[name], second[name]
        if one.shape != other.shape:
            told.append(f"{name}: {one.shape} and {other.shape}")
        elif (share := np.isclose(one, other, rtol=0, atol=APART, equal_nan=True).mean()) < SHARE:
            told.append(f"{name}: {share:.4f} of its values are the same")
    return told


def main(command: str, *paths: str) -> int:
    """The exit status."""
    if command == "save":
        Path(paths[0]).parent.mkdir(parents=True, exist_ok=True)
        np.savez(paths[0], **dict(solves()))
        return 0
    first, second = (dict(np.load(path)) for path in paths)
    told = differences(first, second)
    equal = sum(name in second and first[name].tobytes() == second[name].tobytes() for name in first)
    print("\n".join([*told, f"same_maps: {equal} of {len(first)} maps are equal, bit for bit"]))
    return 1 if told else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
