"""Blender's worlds as the solver's environments.

Read as they are: backgrounds of constant or pictured colour, mixed and added, their pictures turned by Mapping nodes.
What the camera alone sees does not shine.  Any other node tree is rendered once by a second Blender (world_bake.py).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...core.data import F32, F64, Environment
from ...core.errors import BadInput
from ...core.images.clipped_lights import BrightestPixels
from ...core.images.colour import known_space, to_linear_rec709
from ...core.images.environment_image import (
    WIDTH,
    aspect_warning,
    clipped_lights,
    eight_bits,
    from_mirror_ball,
    read_environment_image,
    seen_from,
    unknown_space,
)
from ...core.shading.environment import reduced
from . import world_bake

Warn = Callable[[str], None]
DEEPEST = 64  # nodes one behind the other
GREY = 4  # pixels, the height of a picture of one colour
WORLD = "the world"


class _Unmodelled(Exception):
    """Nodes that must be rendered."""


class _NoImage(Exception):
    """An Environment Texture that shows Cycles' colour of what is missing."""


@dataclass(frozen=True)
class _Term:
    """What adds to the light."""

    factor: F64  # (3,)
    image: Any = None  # None: the same from everywhere
    ball: bool = False  # of a mirror ball
    rotation: tuple[tuple[float, ...], ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))  # world to picture


def lighting(world: Any, alone: bool) -> bool:
    """Whether a world is a view's light: beside lamps only where somebody has given it a picture (else ``alone``).

    Blender gives every new file a grey world.  Where references do show one, it is indirect light.
    """
    return not is_black(world) and (alone or is_pictured(world))


def is_black(world: Any) -> bool:
    """Whether nothing shines, as far as that is seen at a glance."""
    if world is None or not any(_visible(world)):
        return True
    if _plain(world):
        return not any(world.color)
    node = _surface(world)
    if node is None:
        return True
    if node.type != "BACKGROUND":
        return False
    strength, color = node.inputs["Strength"], node.inputs["Color"]
    if not strength.is_linked and strength.default_value == 0:
        return True
    return not color.is_linked and not any(color.default_value[:3])


def is_pictured(world: Any) -> bool:
    """Whether its light has a picture, or any other node tree than one background of one colour."""
    if world is None or _plain(world):
        return False
    node = _surface(world)
    return node is not None and (node.type != "BACKGROUND" or any(socket.is_linked for socket in node.inputs))


def unmodelled(world: Any, view_layer: Any, alone: bool) -> list[str]:
    """What of a world is not modelled, one line each; but for its volume only where it is a light (see `lighting`)."""
    name, found = f"world '{world.name}'", []
    output = None if _plain(world) else world.node_tree.get_output_node("CYCLES")
    if output is not None and _source(output.inputs["Volume"]) is not None:
        found.append(f"{name}: has a volume, which is not modelled; unlink it for the pictures")
    if not lighting(world, alone):
        return found
    if not all(_visible(world)):
        found.append(f"{name}: is hidden from diffuse or glossy rays, which is not modelled; make it visible to both")
    if not getattr(getattr(world, "cycles", None), "use_shadows", True):  # Blender 5
        found.append(f"{name}: casts no shadows, which is not modelled; let it cast them")
    if not view_layer.use_sky or view_layer.world_override not in {None, world}:
        found.append(f"view layer '{view_layer.name}': switches world '{world.name}' off or overrides it, which is not "
                     "modelled; switch Environment on and clear World Override")
    return found


def read_environment(world: Any, turn: float, warn: Warn) -> Environment | None:
    """The light of ``world``, turned by ``turn`` radians about Z; None where it is black.

    Raises BadInput, one line, naming the world or its picture.
    """
    name = f"world '{world.name}'"
    try:
        terms = [_Term(np.array(world.color, np.float64))] if _plain(world) else _shader(_surface(world), 0)
        terms = [term for term in terms if term.factor.any()]
        if not all((np.isfinite(term.factor) & (term.factor >= 0)).all() for term in terms):
            raise BadInput(f"{name}: its colour or strength is negative or not finite; set it again")
        picture, rotation = _together(terms, warn)
    except _NoImage:
        raise BadInput(f"{name}: its Environment Texture has no image; choose an HDR or EXR file") from None
    except _Unmodelled:
        picture, rotation = world_bake.baked(world), np.eye(3)
    if not np.isfinite(picture).all():
        raise BadInput(f"{name}: its light is not finite; lower its strength")
    if not picture.any():
        return None
    cos, sin = float(np.cos(turn)), float(np.sin(turn))
    about = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])  # the world's light turns the other way back
    return Environment(world.name, picture, rotation @ about, turn)


def _visible(world: Any) -> tuple[bool, bool]:
    """Whether diffuse and glossy rays see it."""
    rays = getattr(world, "cycles_visibility", None)  # None: the add-on Cycles is off
    return (True, True) if rays is None else (bool(rays.diffuse), bool(rays.glossy))


def _plain(world: Any) -> bool:
    return world.node_tree is None or (bpy.app.version < (5, 0, 0) and not world.use_nodes)


def _surface(world: Any) -> Any:
    output = world.node_tree.get_output_node("CYCLES")
    return None if output is None else _source(output.inputs["Surface"])


def _source(socket: Any) -> Any:
    """The node behind a socket, past reroutes; None: none."""
    for _ in range(DEEPEST):
        links = [link for link in socket.links if not link.is_muted]
        if not links:
            return None
        if links[0].from_node.type != "REROUTE":
            return links[0].from_node
        socket = links[0].from_node.inputs[0]
    raise _Unmodelled


def _value(socket: Any) -> Any:
    if _source(socket) is not None:
        raise _Unmodelled
    return socket.default_value


def _shader(node: Any, depth: int) -> list[_Term]:
    """What a shader node sends out."""
    if node is None:
        return []
    if node.mute or depth > DEEPEST:
        raise _Unmodelled
    if node.type == "BACKGROUND":
        color, strength = _color(node.inputs["Color"]), float(_value(node.inputs["Strength"]))
        return [_Term(color.factor * strength, color.image, color.ball, color.rotation)]
    if node.type == "ADD_SHADER":
        return [term for socket in node.inputs[:2] for term in _shader(_source(socket), depth + 1)]
    if node.type != "MIX_SHADER":
        raise _Unmodelled
    share = _camera_share(node.inputs[0])
    return [_Term(term.factor * weight, term.image, term.ball, term.rotation)
            for socket, weight in ((node.inputs[1], 1 - share), (node.inputs[2], share)) if weight > 0
            for term in _shader(_source(socket), depth + 1)]


def _camera_share(socket: Any) -> float:
    """A mix's factor for light that surfaces see."""
    node = _source(socket)
    if node is None:
        return float(np.clip(socket.default_value, 0, 1))
    links = [link for link in socket.links if not link.is_muted]
    if node.type == "LIGHT_PATH" and links[0].from_node == node and links[0].from_socket.name == "Is Camera Ray":
        return 0.0
    raise _Unmodelled


def _color(socket: Any) -> _Term:
    """What a Background's colour socket is given."""
    node = _source(socket)
    if node is None:
        return _Term(np.array(socket.default_value[:3], np.float64))
    if node.mute:
        raise _Unmodelled
    if node.type == "RGB":
        return _Term(np.array(node.outputs[0].default_value[:3], np.float64))
    links = socket.links[0]
    if node.type != "TEX_ENVIRONMENT" or (links.from_node == node and links.from_socket.name != "Color"):
        raise _Unmodelled
    if node.image is None:
        raise _NoImage
    mapping = node.texture_mapping
    if tuple(mapping.scale) != (1, 1, 1) or any(mapping.rotation) or any(mapping.translation):
        raise _Unmodelled
    return _Term(np.ones(3), node.image, node.projection == "MIRROR_BALL", _rotation(node.inputs["Vector"]))


def _rotation(socket: Any) -> tuple[tuple[float, ...], ...]:
    """World to picture, of what a picture's Vector socket is given."""
    node, turn = _source(socket), np.eye(3)
    if node is not None and node.type == "MAPPING" and not node.mute:
        scale = np.array(_value(node.inputs["Scale"]), np.float64)
        moved = any(_value(node.inputs["Location"])) if "Location" in node.inputs else False
        rotation = _value(node.inputs["Rotation"])
        if (moved and node.vector_type in {"POINT", "TEXTURE"}) or np.ptp(np.abs(scale)) > 1e-6 or not scale.all():
            raise _Unmodelled
        turn = np.array(rotation.to_matrix(), np.float64) * np.sign(scale)
        turn = turn.T if node.vector_type == "TEXTURE" else turn
        socket = node.inputs["Vector"]
        if _source(socket) is None:
            raise _Unmodelled  # a constant vector
        node = _source(socket)
    if node is None:
        return tuple(tuple(row) for row in turn)
    links = [link for link in socket.links if not link.is_muted]
    if node.type != "TEX_COORD" or links[0].from_node != node or links[0].from_socket.name != "Generated":
        raise _Unmodelled
    return tuple(tuple(row) for row in turn)


def _together(terms: list[_Term], warn: Warn) -> tuple[F32, F64]:
    """The sum of terms as one picture, and its rotation."""
    if not terms:
        return np.zeros((GREY, 2 * GREY, 3), np.float32), np.eye(3)
    pictures = [_picture(term, warn) for term in terms]
    if len(terms) == 1:
        return pictures[0], np.array(terms[0].rotation)
    total = sum((seen_from(picture, np.array(term.rotation)) for picture, term in zip(pictures, terms, strict=True)),
                np.zeros(1))
    return np.asarray(total, np.float32), np.eye(3)


def _picture(term: _Term, warn: Warn) -> F32:
    factor = np.asarray(term.factor, np.float32)
    if term.image is None:
        return np.broadcast_to(factor, (GREY, 2 * GREY, 3)).copy()
    picture = pixels_of(term.image, warn)
    if term.ball:
        return np.asarray(from_mirror_ball(picture) * factor, np.float32)
    for line in aspect_warning(term.image.name, picture):
        warn(line)
    return np.asarray(picture * factor, np.float32)


def pixels_of(image: Any, warn: Warn, whose: str = WORLD) -> F32:
    """(h, w, 3) linear, row 0 at the bottom.  Raises BadInput."""
    inside = image.packed_file is not None or image.source == "GENERATED"
    if not inside and image.source == "FILE":
        path = Path(bpy.path.abspath(image.filepath, library=image.library))
        picture, lines = read_environment_image(path, image.colorspace_settings.name, whose == WORLD)
        for line in lines:
            warn(line)
        return picture
    if not inside:
        raise BadInput(f"image '{image.name}' (of {whose}): is not a single picture; choose one HDR or EXR file")
    if (not image.has_data and image.size[0] == 0) or 0 in image.size:
        raise BadInput(f"image '{image.name}' (of {whose}): has no pixels; choose the file again")
    return _inside(image, warn, whose)


def _inside(image: Any, warn: Warn, whose: str) -> F32:
    """Of a picture that the .blend holds."""
    width, height = image.size
    pixels = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(pixels)
    rgb = pixels.reshape(height, width, 4)[..., :3]
    bad = int((~np.isfinite(rgb) | (rgb < 0)).any(-1).sum())
    if bad:
        warn(f"image '{image.name}' (of {whose}): {bad} pixels are NaN, infinite or negative; they are treated as "
             "black")
    rgb = np.where(np.isfinite(rgb) & (rgb > 0), rgb, np.float32(0))
    if image.is_float and whose == WORLD:
        brightest = BrightestPixels()
        brightest.add(rgb)
        for line in clipped_lights(f"image '{image.name}' (of {whose})", brightest):
            warn(line)
    rgb = reduced(rgb, WIDTH)
    if image.is_float:
        return rgb
    warn(eight_bits(image.name))
    given = image.colorspace_settings.name
    space = known_space(given)
    if space is None:
        raise BadInput(f"image '{image.name}' (of {whose}): {unknown_space(given)}")
    return to_linear_rec709(rgb, space)
