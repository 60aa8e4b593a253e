"""What goes wrong when a capture is shot badly: pictures and figures of docs/shooting.md, each beside the right way.

    python tools/shooting.py [--only NAME ...]

The demo's vase, rendered by Cycles and solved with the default settings.  Writes docs/images/shooting/NAME.jpg and the
tables between the marks of docs/shooting.md (the tables only where nothing is left out).
"""

from __future__ import annotations

import argparse
import json
import math
import re
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
import OpenImageIO as oiio
from mathutils import Vector

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from irpso_addon.blender.files import open_blend  # noqa: E402
from irpso_addon.blender.jobs import indirect  # noqa: E402
from irpso_addon.blender.oiio import ensure_openimageio  # noqa: E402
from irpso_addon.blender.sample import contact_sheet, demo  # noqa: E402
from irpso_addon.blender.scene.scene import read_scene  # noqa: E402
from irpso_addon.core.data import F32, Solution  # noqa: E402
from irpso_addon.core.params import SolveSettings  # noqa: E402
from irpso_addon.core.phrases import percent  # noqa: E402
from irpso_addon.core.samples import vase  # noqa: E402
from irpso_addon.gpu.device import thread  # noqa: E402
from irpso_addon.solve import pipeline  # noqa: E402  # the checkout is no installed package
from studies import pages  # noqa: E402

PAGE, PICTURES = ROOT / "docs" / "shooting.md", ROOT / "docs" / "images" / "shooting"
PIXELS = TEXELS = 160
CAMERAS, LAMPS = 4, 14
COUNTS = (1, 2, 3, 5, 8, 14, 28)
BASE_GAIN, ROUGH_GAIN = 6, 3  # the errors are shown so many times larger
Develop = Callable[[F32], F32]


@dataclass(frozen=True)
class Shoot:
    """A way to shoot the vase.  ``spoil`` changes what the pictures show, and not the scene that is solved."""

    title: str
    lamps: int = LAMPS
    ring: bool = False  # every lamp at one height
    exposure: float = 0.0  # EV, told to the solver
    spoil: Callable[[], None] | None = None
    develop: Develop | None = None  # from radiance times 2^exposure to what the file holds
    jpeg: bool = False  # files are JPEG, with masks beside them
    shown: int = 0  # the view in the picture


def ambient() -> None:
    """The room's lights stay on: a grey world that the scene does not have."""
    world = bpy.data.worlds.new("Room")
    if world.node_tree is None:
        world.use_nodes = True
    background = next(node for node in world.node_tree.nodes if node.type == "BACKGROUND")
    background.inputs["Color"].default_value = (0.06, 0.05, 0.04, 1)
    bpy.context.scene.world = world


def move_lamps() -> None:
    """A third of the lamps stand 40 cm from where they were measured, at 3.2 m from the vase."""
    for i in range(0, LAMPS, 3):
        bpy.data.objects[f"Light {i + 1:02d}"].location += Vector((0.3, -0.25, 0.1))


def cross_polarise() -> None:
    """Filters before lamp and lens, crossed, take the highlights away and leave the diffuse light."""
    nodes = bpy.data.materials["truth"].node_tree.nodes
    next(node for node in nodes if node.type == "BSDF_PRINCIPLED").inputs["Specular IOR Level"].default_value = 0.0


def clip(pixels: F32) -> F32:
    """A sensor's full well."""
    return np.minimum(pixels, 1)


def tone(pixels: F32) -> F32:
    """A picture made for looking at: Narkowicz's fit of the film curve of ACES (2015), over its value of white."""
    shown = np.clip(pixels, 0, 1)
    value = shown * (2.51 * shown + 0.03) / (shown * (2.43 * shown + 0.59) + 0.14)
    return np.asarray(value * (3.16 / 2.54), np.float32)


RIGHT = Shoot("right")
WRONG = {
    "clipped": Shoot("clipped", exposure=2.0, develop=clip),
    "one_light": Shoot("one light", lamps=1),
    "few_lights": Shoot("three lights", lamps=3),
    "no_highlight": Shoot("lights at one height", ring=True),
    "ambient": Shoot("room lights on", spoil=ambient),
    "moved": Shoot("lights moved", spoil=move_lamps),
    "polarised": Shoot("cross-polarised", spoil=cross_polarise),
    "tone": Shoot("tone curve", exposure=-1.0, develop=tone, jpeg=True),
}


@dataclass(frozen=True)
class Outcome:
    """A picture as shot, the solution, and how far it is off."""

    view: F32
    solution: Solution
    base_off: F32  # largest difference of a channel
    base_error: F32  # mean difference over the channels, relative to the truth's mean
    rough_error: F32

    def warnings(self) -> list[str]:
        """Without the object's name."""
        return [text.removeprefix(f"{demo.NAME}: ") for text in self.solution.warnings]

    def figures(self) -> list[str]:
        """Over the texels with a surface: medians of both errors, roughness far off, share that is confident."""
        on = self.solution.maps.coverage
        confident = (self.solution.maps.confidence[on] > 0.5).mean()
        return [f"{percent(np.median(self.base_error[on]), 1)}", f"{np.median(self.rough_error[on]):.3f}",
                f"{percent((self.rough_error[on] > 0.1).mean())}", f"{percent(confident)}"]


def main() -> int:
    """Shoot, solve, draw, tell."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", choices=list(WRONG), default=list(WRONG), metavar="NAME")
    only = parser.parse_args().only
    ensure_openimageio()
    PICTURES.mkdir(parents=True, exist_ok=True)
    right = take(RIGHT)
    taken = {RIGHT: right} | {WRONG[name]: take(WRONG[name]) for name in only}
    rows = [row(shoot.title, outcome, None if shoot is RIGHT else right) for shoot, outcome in taken.items()]
    print(*rows, sep="\n")
    for name in only:
        pair = [tiles("right", right), tiles(WRONG[name].title, taken[WRONG[name]])]
        contact_sheet.save(PICTURES / f"{name}.jpg", pair, quality=75)
    if only == list(WRONG):
        plain = {shoot.lamps: outcome for shoot, outcome in taken.items() if shoot == Shoot(shoot.title, shoot.lamps)}
        plain |= {n: take(Shoot("", lamps=n)) for n in COUNTS if n not in plain}
        fill({"problems": rows, "lights": [f"| {n} | {' | '.join(plain[n].figures())} |" for n in COUNTS]})
        blender = f"Blender {bpy.app.version_string}"
        pages.fill(PAGE, {"made": pages.measured(right.solution.device["renderer"], blender)})
    return 0


def fill(tables: dict[str, list[str]]) -> None:
    """Put rows under the heads of the tables that the page marks."""
    page = PAGE.read_text(encoding="utf-8")
    for mark, rows in tables.items():
        head = re.compile(rf"(<!-- {mark} -->\n\n\|.*\n\|.*\n)(\|.*\n)*")
        page, count = head.subn(lambda found, rows=rows: found[1] + "\n".join(rows) + "\n", page)
        assert count == 1, f"{PAGE}: no table '{mark}'"
    PAGE.write_text(page, encoding="utf-8")


def take(shoot: Shoot) -> Outcome:
    """Shoot the vase in this way, and solve."""
    base, rough = vase.truth(TEXELS)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        pictures = render(shoot, folder, base, rough)
        open_blend(folder / "scene.blend")
        scene = read_scene(None, demo.NAME, folder / "captures.json")
        bounce = indirect.IndirectRenderer.of_open_file(folder / "scene.blend")
        solution = thread.run(lambda: pipeline.solve(scene, SolveSettings(size=TEXELS), bounce=bounce))
        view = demo.read_render(pictures[shoot.shown])[..., :3]
    maps = solution.maps
    base_off = np.abs(maps.base_color - base)
    return Outcome(view, solution, base_off.max(-1), base_off.mean(-1) / base.mean(-1), np.abs(maps.roughness - rough))


def render(shoot: Shoot, folder: Path, base: F32, rough: F32) -> list[Path]:
    """scene.blend and captures.json in the folder, as they are told to the solver; the pictures."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    obj = demo._add_vase()
    cameras = [demo._add_camera(f"Camera {i + 1}", 2 * math.pi * i / CAMERAS, 0.42 if i % 2 == 0 else -0.03)
               for i in range(CAMERAS)]
    lamps = [demo._add_light(f"Light {i + 1:02d}", direction) for i, direction in enumerate(directions(shoot))]
    demo._set_up_render(bpy.context.scene)
    bpy.context.scene.render.resolution_x = bpy.context.scene.render.resolution_y = PIXELS
    blank = folder / "scene.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(blank))
    obj.material_slots[0].material = demo._truth_material(base, rough)
    if shoot.spoil:
        shoot.spoil()
    views, pictures = [], []
    for camera in cameras:
        for lamp in lamps:
            if not demo._same_side(camera, lamp):
                continue
            path = folder / f"view_{len(views):02d}.exr"
            demo._render(path, camera, lamp)
            image, mask = develop(path, shoot)
            pictures.append(image)
            views.append({"image": image.name, "camera": camera.name, "lights": [lamp.name],
                          "exposure": shoot.exposure} | ({} if mask is None else {"mask": mask.name}))
    (folder / "captures.json").write_text(json.dumps({"views": views}), encoding="utf-8")
    return pictures


def directions(shoot: Shoot) -> list[Vector]:
    """Where the lamps are: spread over the sphere down to 35 degrees below the horizon, or all 49 degrees above it."""
    found = []
    for i in range(shoot.lamps):
        share = (i + 0.5) / shoot.lamps
        z = 0.75 if shoot.ring else 0.92 - (0.92 + math.sin(math.radians(35))) * share
        turn, ring = 2.399963 * i - 1.2, math.sqrt(1 - z * z)
        found.append(Vector((ring * math.cos(turn), ring * math.sin(turn), z)))
    return found


def develop(path: Path, shoot: Shoot) -> tuple[Path, Path | None]:
    """The rendered file as the camera would have written it, and a mask if there is one."""
    if shoot.develop is None:
        return path, None
    pixels = oiio.ImageBuf(str(path)).get_pixels(oiio.FLOAT)
    pixels[..., :3] = shoot.develop(pixels[..., :3] * np.float32(2.0**shoot.exposure))
    if not shoot.jpeg:
        write(path, pixels)
        return path, None
    image, mask = path.with_suffix(".jpg"), path.with_suffix(".png")
    srgb = np.where(pixels > 0.0031308, 1.055 * np.maximum(pixels, 1e-9) ** (1 / 2.4) - 0.055, 12.92 * pixels)
    write(image, srgb[..., :3])
    write(mask, pixels[..., 3:])
    return image, mask


def write(path: Path, pixels: F32) -> None:
    """8 bits where the format is none of floats."""
    kind = oiio.FLOAT if path.suffix == ".exr" else oiio.UINT8
    made = oiio.ImageBuf(oiio.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], kind))
    made.set_pixels(oiio.ROI(), np.ascontiguousarray(pixels, np.float32))
    made.specmod().attribute("CompressionQuality", 92)
    assert made.write(str(path)), made.geterror()


# ---- the page


def row(title: str, outcome: Outcome, known: Outcome | None = None) -> str:
    """A line of the table of problems, with the first warning that ``known`` has not as well, figures apart."""
    words = [re.sub(r"[\d.,]+", "", text) for text in known.warnings()] if known else []
    said = [text for text in outcome.warnings() if re.sub(r"[\d.,]+", "", text) not in words]
    return f"| {title} | {' | '.join(outcome.figures())} | {said[0] if said and known else ''} |"


def tiles(title: str, outcome: Outcome) -> list[tuple[str, F32]]:
    """A row of the picture."""
    maps = outcome.solution.maps
    grey = lambda a: np.repeat(a[..., None], 3, -1)  # noqa: E731
    return [
        (title, encoded(outcome.view)), ("base colour", encoded(maps.base_color)),
        (f"error x{BASE_GAIN}", heat(BASE_GAIN * outcome.base_off * maps.coverage)),
        ("roughness", grey(maps.roughness)),
        (f"error x{ROUGH_GAIN}", heat(ROUGH_GAIN * outcome.rough_error * maps.coverage)),
        ("confidence", grey(maps.confidence)),
    ]


def encoded(linear: F32) -> F32:
    """For display, about sRGB."""
    return np.asarray(np.clip(linear, 0, 1) ** (1 / 2.2), np.float32)


def heat(value: F32) -> F32:
    """0 black over red and yellow to 1 white."""
    return np.asarray(np.clip(np.stack([3 * value, 3 * value - 1, 3 * value - 2], -1), 0, 1), np.float32)


if __name__ == "__main__":
    sys.exit(main())
