"""Environments that are formulas, and worlds of them."""

from __future__ import annotations

import math
from pathlib import Path

import bpy
import numpy as np
import OpenImageIO

from irpso_addon.core.data import F64

HDRI_HEIGHT = 512
KINDS = ("clear", "day", "studio", "room", "overcast")  # of environments, see `radiance`
SUN = np.array([0.5, -0.6, 0.62]) / np.linalg.norm([0.5, -0.6, 0.62])
WINDOW = np.array([-0.8, 0.5, 0.3]) / np.linalg.norm([-0.8, 0.5, 0.3])
BOXES = ((WINDOW, 0.6, 0.4, 5.0), (np.array([0.9, 0.3, 0.4]), 0.2, 0.7, 3.0),
         (np.array([0.1, 0.2, 1.0]), 0.5, 0.5, 2.0))  # studio: middle, half width and height at distance 1, radiance


def _plane(d: F64, toward: F64) -> tuple[F64, F64, F64]:
    """Of directions (..., 3): their part along ``toward``, and where they meet the plane at distance 1 there."""
    axis = toward / np.linalg.norm(toward)
    side = np.cross(axis, (0, 0, 1.0))
    side /= np.linalg.norm(side)
    ahead = d @ axis
    x, y = (d @ other / np.maximum(ahead, 1e-6) for other in (side, np.cross(side, axis)))
    return ahead, x, y


def _box(d: F64, toward: F64, width: float, height: float, strength: float) -> F64:
    """Radiance of a soft box so far from the middle to its sides, at distance 1."""
    ahead, x, y = _plane(d, toward)
    return np.asarray(strength * ((ahead > 0) & (np.abs(x) < width) & (np.abs(y) < height)))


def radiance(d: F64, kind: str) -> F64:
    """(..., 3) of directions (..., 3)."""
    def glow(toward: F64, width: float, strength: float, colour: tuple[float, float, float]) -> F64:
        off = np.arccos(np.clip(d @ (toward / np.linalg.norm(toward)), -1, 1))
        return (strength * np.exp(-0.5 * (off / width) ** 2))[..., None] * np.array(colour)

    up = np.clip(d[..., 2], 0, 1)
    sky = np.where(d[..., 2] > 0, (1 + 2 * up) / 3, 0.15)[..., None] * np.array([0.75, 0.9, 1.1])
    if kind == "overcast":
        return sky
    if kind == "clear":  # a bare sun, as narrow as the picture's pixels allow
        return np.asarray(0.5 * sky + glow(SUN, 0.008, 8000.0, (1.0, 0.95, 0.85)))
    if kind == "studio":
        return np.asarray(sum((_box(d, *box) for box in BOXES), 0.05)[..., None] * np.ones(3))
    if kind == "room":
        return np.asarray(0.08 * np.ones(3) + glow(np.array([0.3, 0.9, 0.5]), 0.12, 40.0, (1.0, 0.85, 0.65))
                          + glow(np.array([-0.9, -0.4, 0.1]), 0.2, 9.0, (0.8, 0.9, 1.0)))
    ahead, x, y = _plane(d, WINDOW)
    pane = (ahead > 0) & (np.abs(x) < 0.45) & (np.abs(y) < 0.6) & (np.abs(x) > 0.03) & (np.abs(y - 0.1) > 0.03)
    return np.asarray(0.5 * sky + 6.0 * pane[..., None] * np.array([0.9, 1.0, 1.1])
                      + glow(SUN, 0.03, 250.0, (1.0, 0.9, 0.75)))


def hdri(kind: str, path: Path) -> None:
    """Write an equirectangular picture, as Blender maps it."""
    v, u = (np.arange(HDRI_HEIGHT) + 0.5) / HDRI_HEIGHT, (np.arange(2 * HDRI_HEIGHT) + 0.5) / (2 * HDRI_HEIGHT)
    latitude, longitude = (math.pi * (v - 0.5))[:, None], (2 * math.pi * (0.5 - u))[None]
    d = np.stack([np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude),
                  np.sin(latitude) + 0 * longitude], -1)
    save(radiance(d, kind), path)


def save(picture: F64, path: Path) -> None:
    """Write (h, w, C) pixels, the bottom row first."""
    height, width, channels = picture.shape
    buffer = OpenImageIO.ImageBuf(OpenImageIO.ImageSpec(width, height, channels, OpenImageIO.FLOAT))
    buffer.set_pixels(OpenImageIO.ROI(), np.ascontiguousarray(picture[::-1], np.float32))
    buffer.write(str(path))


def world(kind: str, folder: Path) -> bpy.types.World:
    """A world of a formula, which Mapping can turn."""
    path = folder / f"{kind}.exr"
    hdri(kind, path)
    return world_of(kind, path)


def world_of(name: str, path: Path) -> bpy.types.World:
    """A world of a picture, which Mapping can turn."""
    made = bpy.data.worlds.new(name)
    if made.node_tree is None:
        made.use_nodes = True
    tree = made.node_tree
    tree.nodes.clear()
    coordinates, mapping, picture, background, output = (tree.nodes.new(f"ShaderNode{name}") for name in (
        "TexCoord", "Mapping", "TexEnvironment", "Background", "OutputWorld"))
    picture.image = bpy.data.images.load(str(path))
    for one, other in ((coordinates.outputs["Generated"], mapping.inputs["Vector"]),
                       (mapping.outputs["Vector"], picture.inputs["Vector"]),
                       (picture.outputs["Color"], background.inputs["Color"]),
                       (background.outputs[0], output.inputs["Surface"])):
        tree.links.new(one, other)
    if hasattr(made.cycles, "sampling_method"):
        made.cycles.sampling_method = "AUTOMATIC"
    return made
