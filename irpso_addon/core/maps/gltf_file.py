"""A mesh with its material as one binary glTF 2.0 file (GLB), images inside.

Khronos, "glTF 2.0 Specification" (2021), sections 3.7 (meshes), 3.9 (materials), 4.4 (GLB), KHR_materials_specular, and
KHR_materials_clearcoat: a layer of index of refraction 1.5, as the Principled BSDF's Coat.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..data import F32, MeshArrays
from ..errors import BadInput
from .targets import DIELECTRIC

FLOAT, UNSIGNED = 5126, 5125  # component types
VERTICES, INDICES = 34962, 34963  # targets of buffer views
LINEAR, MIPMAPS, REPEAT = 9729, 9987, 10497  # of samplers
MOST_BYTES = 2**32 - 1  # that a GLB's header can count


def glb(
    mesh: MeshArrays, images: Mapping[str, Path], level: float | None, scale: float,
    coat: tuple[float, float] = (0.0, 0.0),
) -> bytes:
    """The whole file: the mesh as it stands in the scene, metres, turned from Z up to Y up.

    ``images``: PNG files by `TargetFile.name`.  ``level``: Specular IOR Level of the object, None: the alpha of the
    specular image times ``scale`` is twice that.  ``coat``: weight and roughness of the object's.  Raises BadInput
    where it is larger than a GLB may be.
    """
    file = _Glb()
    primitive: dict[str, Any] = {"attributes": {}, "material": 0, "mode": 4}
    corners, order = _vertices(mesh)
    for name, values in corners.items():
        bounds = {"min": values.min(0).tolist(), "max": values.max(0).tolist()} if name == "POSITION" else {}
        primitive["attributes"][name] = file.accessor(values, f"VEC{values.shape[1]}", VERTICES, **bounds)
    primitive["indices"] = file.accessor(order, "SCALAR", INDICES)
    textures = {key: file.texture(path) for key, path in images.items()}
    material = _material(mesh.name, textures, level, scale, coat)
    root: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "IRPSO"}, "scene": 0, "scenes": [{"nodes": [0]}],
        "nodes": [{"name": mesh.name, "mesh": 0}], "meshes": [{"name": mesh.name, "primitives": [primitive]}],
        "materials": [material],
        "samplers": [{"magFilter": LINEAR, "minFilter": MIPMAPS, "wrapS": REPEAT, "wrapT": REPEAT}],
    }
    if "extensions" in material:
        root["extensionsUsed"] = list(material["extensions"])
    return file.bytes(root)


def _vertices(mesh: MeshArrays) -> tuple[dict[str, F32], Any]:
    """Attributes of the vertices, each once, and which of them the triangles' corners are."""
    turned = [np.stack([v[..., 0], v[..., 2], -v[..., 1]], -1) for v in (mesh.positions, mesh.normals)]
    uvs = mesh.uvs * np.array([1, -1], np.float32) + np.array([0, 1], np.float32)  # v = 0 is the top there
    rows = np.concatenate([array.reshape(-1, array.shape[-1]) for array in (*turned, uvs)], axis=1)
    rows = np.ascontiguousarray(rows, "<f4") + np.float32(0)  # no -0
    _, first, order = np.unique(rows.view(f"V{rows.shape[1] * 4}").ravel(), return_index=True, return_inverse=True)
    kept = rows[first]
    return ({"POSITION": kept[:, :3], "NORMAL": kept[:, 3:6], "TEXCOORD_0": kept[:, 6:]},
            np.asarray(order, "<u4").reshape(-1, 1))


def _material(
    name: str, textures: Mapping[str, int], level: float | None, scale: float, coat: tuple[float, float],
) -> dict[str, Any]:
    """Metal and roughness as the packed image has them; F0 of the dielectric is 0.04 times weight times colour."""
    packed = {"index": textures["{}_occlusionRoughnessMetallic"]}
    material: dict[str, Any] = {
        "name": name, "doubleSided": True, "occlusionTexture": packed,
        "pbrMetallicRoughness": {"baseColorTexture": {"index": textures["{}_baseColor"]},
                                 "metallicRoughnessTexture": packed},
    }
    if "{}_normal" in textures:
        material["normalTexture"] = {"index": textures["{}_normal"]}
    specular: dict[str, Any] = {}
    if level is None:
        specular["specularTexture"] = {"index": textures["{}_specularWeight"]}
    elif level != DIELECTRIC:
        specular["specularFactor"] = min(2 * level, 1.0)
        scale = max(2 * level, 1.0)
    if scale > 1:  # a weight is at most 1, a colour may be more
        specular["specularColorFactor"] = [scale] * 3
    extensions = {"KHR_materials_specular": specular} if specular else {}
    if coat[0] > 0:
        extensions["KHR_materials_clearcoat"] = {"clearcoatFactor": coat[0], "clearcoatRoughnessFactor": coat[1]}
    return {**material, "extensions": extensions} if extensions else material


class _Glb:
    """The binary chunk as it grows, and the records that say what lies in it."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._length = 0
        self._views: list[dict[str, Any]] = []
        self._accessors: list[dict[str, Any]] = []
        self._images: list[dict[str, Any]] = []

    def accessor(self, values: Any, kind: str, target: int, **bounds: Any) -> int:
        """Number of an array (n, components) of little-endian numbers."""
        view = self._view(values.tobytes(), target=target)
        component = FLOAT if values.dtype.kind == "f" else UNSIGNED
        self._accessors.append({"bufferView": view, "componentType": component, "count": len(values), "type": kind,
                                **bounds})
        return len(self._accessors) - 1

    def texture(self, path: Path) -> int:
        """Number of a texture, and of its image: the file's bytes."""
        self._images.append({"name": path.stem, "mimeType": "image/png", "bufferView": self._view(path.read_bytes())})
        return len(self._images) - 1

    def _view(self, content: bytes, **more: Any) -> int:
        self._views.append({"buffer": 0, "byteOffset": self._length, "byteLength": len(content), **more})
        self._parts.append(content + b"\0" * (-len(content) % 4))
        self._length += len(self._parts[-1])
        return len(self._views) - 1

    def bytes(self, root: dict[str, Any]) -> bytes:
        """Header, JSON chunk, binary chunk.  Raises BadInput."""
        root = {**root, "buffers": [{"byteLength": self._length}], "bufferViews": self._views,
                "accessors": self._accessors, "images": self._images,
                "textures": [{"sampler": 0, "source": i} for i in range(len(self._images))]}
        text = json.dumps(root, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        total = 12 + 8 + len(text) + 8 + self._length
        if total > MOST_BYTES:
            raise BadInput(f"{root['nodes'][0]['name']}: does not fit in a GLB file, which holds 4 GB; "
                           "export smaller maps")
        numbers = [np.array(values, "<u4").tobytes() for values in ((2, total, len(text)), (self._length,))]
        return b"".join([b"glTF", numbers[0], b"JSON", text, numbers[1], b"BIN\0", *self._parts])
