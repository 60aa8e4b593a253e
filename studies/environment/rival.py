"""Mitsuba 3 on pictures under environments alone: ``python studies/environment/rival.py PICTURES EXPORT OUT.json``.

PICTURES and EXPORT are folders as ``contest.py`` has them.  Runs under a Python with Mitsuba, as
studies/bench/capture_mitsuba.py, whose optimiser and material it uses.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any, ClassVar

import drjit as dr
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from studies.bench import capture_mitsuba as bench

mi = bench.mi
# Columns: the axes of Mitsuba's environment maps, whose Y is up, in Blender's world, whose Z is.
FROM_MITSUBA = np.array([[0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1.0]])


class Sampled(bench.Matched):
    """The same material, which also says where its lobe looks: half of the samples by GGX, half by the cosine."""

    def sample(self, ctx, si, sample1, sample2, active):
        with dr.suspend_grad():
            alpha2 = dr.power(self.roughness.eval_1(si, active), 4)
            cos_h2 = (1 - sample2.x) / (1 + (alpha2 - 1) * sample2.x)
            sine, turn = dr.safe_sqrt(1 - cos_h2), dr.two_pi * sample2.y
            half = mi.Vector3f(sine * dr.cos(turn), sine * dr.sin(turn), dr.safe_sqrt(cos_h2))
            result = dr.zeros(mi.BSDFSample3f)
            result.wo = dr.select(sample1 < 0.5, 2 * dr.dot(si.wi, half) * half - si.wi,
                                  mi.warp.square_to_cosine_hemisphere(sample2))
            result.pdf = self.pdf(ctx, si, result.wo, active)
            result.eta, result.sampled_type = 1.0, +mi.BSDFFlags.GlossyReflection
        active &= result.pdf > 0
        return result, dr.select(active, self.eval(ctx, si, result.wo, active) / result.pdf, 0.0)

    def pdf(self, ctx, si, wo, active):
        with dr.suspend_grad():
            cos_v, cos_l, half = mi.Frame3f.cos_theta(si.wi), mi.Frame3f.cos_theta(wo), dr.normalize(si.wi + wo)
            alpha2, cos_h = dr.power(self.roughness.eval_1(si, active), 4), mi.Frame3f.cos_theta(half)
            lobe = alpha2 / (dr.pi * dr.square(1 + (alpha2 - 1) * dr.square(cos_h)))
            pdf = 0.5 * cos_l * dr.inv_pi + 0.5 * lobe * cos_h / dr.maximum(4 * dr.dot(si.wi, half), 1e-6)
            return dr.select(active & (cos_v > 0) & (cos_l > 0), pdf, 0.0)


mi.register_bsdf("matched", lambda props: Sampled(props))


class UnderWorlds(bench.Run):
    """Views that worlds light, which are not turned."""

    samples, texture = 16, 128
    integrator: ClassVar = {"type": "direct", "emitter_samples": 1, "bsdf_samples": 1}

    def lights(self, capture: Path, scene: dict[str, Any]) -> dict[str, Any]:
        """Each world's picture."""
        assert all(view["turn"] == 0 for view in self.views), "worlds are to be as their pictures are"
        return {name: {"type": "envmap", "filename": str(capture / f"{name}.exr"),
                       "to_world": mi.ScalarTransform4f(FROM_MITSUBA)}
                for name in dict.fromkeys(view["world"] for view in self.views)}

    def lit_by(self, view: dict[str, Any]) -> str:
        """The world of a view."""
        return str(view["world"])


def main() -> None:
    """Command line."""
    options = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    options.add_argument("pictures", type=Path)
    options.add_argument("export", type=Path)
    options.add_argument("out", type=Path)
    options.add_argument("--bsdf", choices=("stock", "matched"), default="matched")
    options.add_argument("--lr", type=float, default=0.02)
    options.add_argument("--samples", type=int, default=UnderWorlds.samples, help="a pixel")
    options.add_argument("--budget", type=float, default=90.0, help="seconds")
    given = options.parse_args()
    start = time.perf_counter()
    UnderWorlds.samples = given.samples
    run = UnderWorlds(given.pictures, given.export, given.bsdf)
    setup = time.perf_counter() - start
    rows, steps = run.optimise(given.lr, given.budget, 0)
    given.out.write_text(json.dumps({
        "bsdf": given.bsdf, "lr": given.lr, "samples": given.samples, "setup_seconds": setup, "iterations": steps,
        "rows": [{"seconds": row["seconds"], **row["seen"]} for row in rows],
        "version": mi.__version__}, indent=1), encoding="utf-8")
    print(f"mitsuba {given.bsdf}, lr {given.lr}, {given.samples} samples, {steps} iterations: {rows[-1]['seen']}")


if __name__ == "__main__":
    main()
