"""Mitsuba 3 on a capture: Adam on base colour and roughness textures, scored while it runs.

  python studies/bench/capture_mitsuba.py CAPTURE EXPORT OUT.json [--bsdf stock|matched] [--lr .02] [--budget 90]

EXPORT is what capture_judge.py made of CAPTURE.  Needs Mitsuba 3.9 and an LLVM of version 18 or later (llvm_ad_rgb).
`stock` is Mitsuba's own `principled` at specular .5, as a practitioner would take it; `matched` evaluates Cycles'
Principled BSDF as the product does, by the product's own energy table.

Settings, the best found on captures of this kind: integrator `direct` with one emitter sample, one random view an
iteration (without replacement), 4 samples a pixel, L1 on wholly covered pixels over the mean radiance, learning rate
decayed exponentially to 5 % at the budget, base in .01 to 1, roughness in .05 to 1, textures of 512, start .5 and .5.
Seconds are those inside the optimisation's loop; import, scene loading, snapshots and scoring are not in them.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import os
import sys
import time
from dataclasses import asdict
from pathlib import Path
from typing import ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np


def find_llvm() -> None:
    """Dr.Jit takes the libLLVM.so it finds first, which may be too old."""
    for name in (f"libLLVM.so.{version}.1" for version in range(22, 17, -1)):
        try:
            ctypes.CDLL(name)
        except OSError:
            continue
        os.environ.setdefault("DRJIT_LIBLLVM_PATH", name)
        return


find_llvm()
mi.set_variant("llvm_ad_rgb")

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from irpso_addon.core.evaluation.metrics import map_errors  # noqa: E402
from irpso_addon.core.resampling import at_size  # noqa: E402
from irpso_addon.core.shading.brdf import principled_energy  # noqa: E402
from irpso_addon.core.shading.tables import IOR  # noqa: E402

MARKS = (1, 2, 5, 10, 20, 30, 45, 60, 90, 120, 180)  # seconds at which the textures are scored
TEXTURE = 512
SAMPLES = 4  # a pixel
NODES = 466  # of the energy table along roughness and cosine: those of Cycles are among them
DECAY = 0.05  # of the learning rate, at the budget
BASE, ROUGH = (0.01, 1.0), (0.05, 1.0)
BASE_KEY, ROUGH_KEY = "base_color.data", "roughness.data"


class Matched(mi.BSDF):
    """base (1 - A(r, cos_v)) / pi + comp(r, cos_v) D F G / (4 cos_l cos_v): core/shading/brdf.py in Dr.Jit."""

    def __init__(self, props):
        mi.BSDF.__init__(self, props)
        self.base_color, self.roughness = props["base_color"], props["roughness"]
        self.m_components = [mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide]
        self.m_flags = self.m_components[0]
        nodes = np.linspace(0, 1, NODES)
        table = principled_energy(nodes[:, None], nodes[None, :]).astype(np.float32)  # comp and A
        self.energy = mi.Texture2f(mi.TensorXf(table), wrap_mode=dr.WrapMode.Clamp)

    def traverse(self, callback):
        callback.put("base_color", self.base_color, mi.ParamFlags.Differentiable)
        callback.put("roughness", self.roughness, mi.ParamFlags.Differentiable)

    def eval(self, ctx, si, wo, active):
        cos_v, cos_l = mi.Frame3f.cos_theta(si.wi), mi.Frame3f.cos_theta(wo)
        active &= (cos_v > 0) & (cos_l > 0)
        base, rough = self.base_color.eval(si, active), self.roughness.eval_1(si, active)
        alpha2 = dr.square(dr.square(rough))
        half = dr.normalize(si.wi + wo)
        cos_h2 = dr.square(mi.Frame3f.cos_theta(half))
        peak = cos_h2 * alpha2 + dr.maximum(1 - cos_h2, 0)
        shadowing = 0.5 / (cos_l * dr.sqrt(dr.square(cos_v) * (1 - alpha2) + alpha2)
                           + cos_v * dr.sqrt(dr.square(cos_l) * (1 - alpha2) + alpha2))
        fresnel = mi.fresnel(dr.dot(si.wi, half), IOR)[0]
        # A texture's nodes lie at the centres of its texels.
        at = (mi.Point2f(cos_v, rough) * (NODES - 1) + 0.5) / NODES
        comp, dimming = self.energy.eval(at, active)
        specular = comp * fresnel * shadowing * alpha2 / (dr.pi * dr.square(peak))
        return dr.select(active, (base * (dr.inv_pi * (1 - dimming)) + mi.Color3f(specular)) * cos_l, 0.0)

    def sample(self, ctx, si, sample1, sample2, active):
        return dr.zeros(mi.BSDFSample3f), mi.Color3f(0.0)  # point lights alone: nothing is ever sampled

    def pdf(self, ctx, si, wo, active):
        return dr.select(active, mi.Frame3f.cos_theta(wo) * dr.inv_pi, 0.0)

    def eval_pdf(self, ctx, si, wo, active):
        return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

    def to_string(self):
        return "Matched"


mi.register_bsdf("matched", lambda props: Matched(props))


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("capture", type=Path)
    options.add_argument("export", type=Path)
    options.add_argument("out", type=Path)
    options.add_argument("--bsdf", choices=("stock", "matched"), default="stock")
    options.add_argument("--lr", type=float, default=0.02)
    options.add_argument("--budget", type=float, default=90.0)
    options.add_argument("--seed", type=int, default=0)
    given = options.parse_args()
    started = time.perf_counter()
    run = Run(given.capture, given.export, given.bsdf)
    setup = time.perf_counter() - started
    rows, iterations = run.optimise(given.lr, given.budget, given.seed)
    given.out.write_text(json.dumps({
        "method": f"mitsuba {given.bsdf}", "lr": given.lr, "budget": given.budget, "seed": given.seed,
        "setup_seconds": setup, "iterations": iterations, "rows": rows,
        "versions": {"mitsuba": mi.__version__, "drjit": dr.__version__},
    }, indent=1))
    print(f"{given.capture.name}: mitsuba {given.bsdf}, {iterations} iterations: {rows[-1]}")


class Run:
    """One capture, loaded, with the textures to be found."""

    samples, texture = SAMPLES, TEXTURE
    integrator: ClassVar = {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0}

    def __init__(self, capture: Path, export: Path, bsdf: str) -> None:
        scene = json.loads((export / "scene.json").read_text())
        self.views = json.loads((capture / "captures.json").read_text())["views"]
        self.judge = np.load(export / "judge.npz")
        pictures = [np.array(mi.Bitmap(str(capture / view["image"])).convert(
            component_format=mi.Struct.Type.Float32)) for view in self.views]
        whole = [picture[..., 3:] > 0.999 for picture in pictures]
        self.level = float(np.mean([p[..., :3][w[..., 0]].mean() for p, w in zip(pictures, whole, strict=True)]))
        self.references = [mi.TensorXf(p[..., :3].copy()) for p in pictures]
        self.masks = [mi.TensorXf(w.astype(np.float32)) for w in whole]
        start = np.full((self.texture, self.texture, 3), 0.5, np.float32)
        kind = {"type": "principled", "specular": 0.5} if bsdf == "stock" else {"type": "matched"}
        material = mi.load_dict({**kind, "base_color": bitmap(start), "roughness": bitmap(start[..., :1])})
        mesh = mi.load_dict({"type": "ply", "filename": str(export / "mesh.ply"), "bsdf": material})
        height, width = pictures[0].shape[:2]
        self.sensors = {name: sensor(camera, width, height) for name, camera in scene["cameras"].items()}
        self.scenes = {name: mi.load_dict({"type": "scene", "mesh": mesh, "light": light})
                       for name, light in self.lights(capture, scene).items()}
        self.renderer = mi.load_dict(self.integrator)
        self.parameters = mi.traverse(material)
        self.parameters.keep([BASE_KEY, ROUGH_KEY])

    def lights(self, capture: Path, scene: dict) -> dict:
        """What shines, by a key of its own."""
        return {name: {"type": "point", "position": light["position"],
                       "intensity": {"type": "rgb", "value": [light["watts"] / (4 * np.pi)] * 3}}
                for name, light in scene["lights"].items()}

    def lit_by(self, view: dict) -> str:
        """The key of what shines in a view."""
        return view["lights"][0]

    def optimise(self, rate: float, budget: float, seed: int) -> tuple[list[dict], int]:
        """The scores at each mark, and how many iterations there were."""
        rng = np.random.default_rng(seed)
        adam = mi.ad.Adam(lr=rate)
        for key in (BASE_KEY, ROUGH_KEY):
            adam[key] = mi.TensorXf(self.parameters[key])
        self.parameters.update(adam)
        marks = [mark for mark in MARKS if mark < budget] + [budget]
        order: list[int] = []
        rows: list[dict] = []
        seconds, step = 0.0, 0
        while marks:
            start = time.perf_counter()
            adam.set_learning_rate(rate * DECAY ** min(1.0, seconds / budget))
            order = order or list(rng.permutation(len(self.views)))
            i = int(order.pop())
            view = self.views[i]
            image = mi.render(self.scenes[self.lit_by(view)], params=self.parameters, spp=self.samples,
                              spp_grad=self.samples, sensor=self.sensors[view["camera"]], integrator=self.renderer,
                              seed=step)
            dr.backward(dr.mean(dr.abs(image - self.references[i]) * self.masks[i] / self.level, axis=None))
            adam.step()
            adam[BASE_KEY], adam[ROUGH_KEY] = dr.clip(adam[BASE_KEY], *BASE), dr.clip(adam[ROUGH_KEY], *ROUGH)
            self.parameters.update(adam)
            dr.eval(adam[BASE_KEY], adam[ROUGH_KEY])
            dr.sync_thread()
            seconds += time.perf_counter() - start
            step += 1
            while marks and seconds >= marks[0]:
                rows.append({"seconds": float(marks.pop(0)), **self.score(adam)})
        return rows, step

    def score(self, adam) -> dict:
        grid = self.judge["seen"].shape[0]
        square = self.texture, self.texture
        base = at_size(np.array(adam[BASE_KEY]).reshape(*square, 3), grid)
        rough = at_size(np.array(adam[ROUGH_KEY]).reshape(*square, 1), grid)[..., 0]
        return {where: asdict(map_errors(base, rough, self.judge["base"], self.judge["rough"], self.judge[where]))
                for where in ("seen", "informed") if where in self.judge}


def bitmap(values):
    """A texture whose row 0 is v = 0, as in Blender."""
    return {"type": "bitmap", "data": mi.TensorXf(np.ascontiguousarray(values)), "filter_type": "bilinear",
            "wrap_mode": "clamp", "raw": True}


def sensor(camera, width, height):
    """Blender's camera: it looks along its -Z, Mitsuba's along +Z with +X to the left."""
    matrix = np.array(camera["matrix"]) @ np.diag([-1, 1, -1, 1.0])
    return mi.load_dict({
        "type": "perspective", "fov": float(np.degrees(camera["angle_x"])), "fov_axis": "x", "near_clip": 0.1,
        "far_clip": 100.0, "to_world": mi.ScalarTransform4f(matrix),
        "film": {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"},
                 "pixel_format": "rgb", "component_format": "float32"},
        "sampler": {"type": "independent", "sample_count": 1}})


if __name__ == "__main__":
    main()
