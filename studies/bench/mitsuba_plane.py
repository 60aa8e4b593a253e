"""Rival: Mitsuba 3, Adam on textures of a flat plane under point lamps, as its tutorials do.

Mitsuba fits its own `principled` to its own pictures of the same maps (its diffuse term is another than ours), so that
the model is right for both.  `direct` integrator, one sample, one texel a pixel, all views in each iteration.
"""

from __future__ import annotations

import os
import re
import time
from dataclasses import asdict
from glob import glob

import numpy as np

from tests.support.texel_problem import Estimate, Problem

RATE = 0.03  # of Adam; .01 arrives later, at the same errors
MARKS = (10, 20, 40, 60, 80, 100, 140, 200, 300, 500, 800, 1200)


def pick_llvm() -> None:
    """The newest LLVM of a Linux system: Dr.Jit needs 16 or later, and takes an older one first where both are."""
    found = {int(m.group(1)): path for path in glob("/usr/lib/*/libLLVM*.so*")
             if (m := re.search(r"libLLVM(?:-|\.so\.)(\d+)", path))}
    if found and max(found) >= 16:
        os.environ.setdefault("DRJIT_LIBLLVM_PATH", found[max(found)])


def run(problem: Problem, limit: float) -> list[dict[str, float | str]]:
    """Points of one optimisation, snapshots outside the clock, until so many seconds."""
    pick_llvm()
    import drjit as dr
    import mitsuba as mi

    mi.set_variant("cuda_ad_rgb" if "cuda_ad_rgb" in mi.variants() and _has_cuda() else "llvm_ad_rgb")
    truth, n = problem.truth, problem.spec.size
    references = []
    for lamp in problem.lamps:
        scene = mi.load_dict(_scene(mi, lamp, truth.base, truth.roughness))
        references.append(dr.detach(mi.render(scene, spp=1, seed=0)))
    dr.eval(references)
    scenes = [mi.load_dict(_scene(mi, lamp, 0 * truth.base + 0.5, 0 * truth.roughness + 0.5))
              for lamp in problem.lamps]
    parameters = [mi.traverse(scene) for scene in scenes]
    base, rough = (next(k for k in parameters[0].keys() if word in k and k.endswith("data"))
                   for word in ("base_color", "roughness"))
    optimiser = mi.ad.Adam(lr=RATE)
    optimiser[base], optimiser[rough] = parameters[0][base], parameters[0][rough]
    points: list[dict[str, float | str]] = []
    seconds = 0.0
    for number in range(1, MARKS[-1] + 1):
        start = time.perf_counter()
        loss = 0.0
        for scene, values, reference in zip(scenes, parameters, references, strict=True):
            values[base], values[rough] = optimiser[base], optimiser[rough]
            values.update()
            loss += dr.mean(dr.square(mi.render(scene, values, spp=1, seed=0) - reference), axis=None)
        dr.backward(loss)
        optimiser.step()
        optimiser[base], optimiser[rough] = dr.clip(optimiser[base], 0.001, 1), dr.clip(optimiser[rough], 0.05, 1)
        dr.eval(optimiser[base], optimiser[rough])
        dr.sync_thread()
        seconds += time.perf_counter() - start
        if number in MARKS or seconds > limit:
            found = Estimate(np.array(optimiser[base], np.float64).reshape(n, n, 3),
                             np.array(optimiser[rough], np.float64).reshape(n, n))
            points.append({"setting": f"{number} steps", "seconds": seconds, **asdict(problem.score(found))})
        if seconds > limit:
            break
    return points


def _has_cuda() -> bool:
    try:
        import torch
    except ImportError:
        return False
    return bool(torch.cuda.is_available())


def _scene(mi, lamp, base, roughness):  # type: ignore[no-untyped-def]
    def texture(a):  # type: ignore[no-untyped-def]
        return {"type": "bitmap", "data": mi.TensorXf(a.astype(np.float32)), "filter_type": "nearest", "raw": True}

    n = len(base)
    return {
        "type": "scene", "integrator": {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0},
        "sensor": {
            "type": "orthographic", "to_world": mi.ScalarTransform4f().look_at([0, 0, 3], [0, 0, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": n, "height": n, "rfilter": {"type": "box"}, "pixel_format": "rgb"},
            "sampler": {"type": "independent", "sample_count": 1},
        },
        "plane": {"type": "rectangle", "bsdf": {"type": "principled", "base_color": texture(base),
                                                "roughness": texture(roughness[..., None]), "specular": 0.5}},
        "lamp": {"type": "point", "position": [float(x) for x in lamp], "intensity": 50.0},
    }
