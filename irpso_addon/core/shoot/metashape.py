"""Cameras that Agisoft Metashape exports as XML (File, Export, Export Cameras, Agisoft XML).

Source: the Metashape Professional manual, appendix "Camera models", and files that Metashape 2.0 wrote.  ``cx`` and
``cy`` count from the picture's middle, a pixel's centre lies at (0.5, 0.5), ``b1`` adds to the horizontal focal length
alone, ``b2`` is the skew, and ``p1`` and ``p2`` stand the other way round than OpenCV's:

    x' = x (1 + k1 r^2 + ...) + p1 (r^2 + 2 x^2) + 2 p2 x y        u = width / 2 + cx + (f + b1) x' + b2 y'
    y' = y (1 + k1 r^2 + ...) + p2 (r^2 + 2 y^2) + 2 p1 x y        v = height / 2 + cy + f y'

A fisheye's x and y are those of the equidistant projection.  A camera's ``transform`` (4 x 4 by rows, axes x right,
y down, z forward) leads into its component.  The component's ``transform`` (rotation, translation, scale), or the
chunk's, leads from there into the chunk's coordinates, in which the mesh is exported.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..data import F64
from ..errors import BadInput
from ..lens import Lens
from ..storage.text_file import read_text
from .project import Draft, Project, Unusable, checked, number, numbers, size

EXPORT = "in Metashape, choose File, Export, Export Cameras, Agisoft XML"
FISHEYES = ("fisheye", "equidistant_fisheye")  # one model: the second is its name beside the equisolid one's
MOST_ELEMENTS, DEEPEST = 3_000_000, 50


@dataclass(frozen=True)
class _Similarity:
    """World = scale * rotation * x + translation."""

    rotation: F64  # (3, 3)
    translation: F64  # (3,)
    scale: float
    scaled: bool  # whether the file states the scale


class _Builder(ElementTree.TreeBuilder):
    """Elements; no more and no deeper than a project has, and no entities of the file's own."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.path, self.count, self.depth = path, 0, 0

    def doctype(self, *_: object) -> None:
        raise BadInput(f"{self.path}: declares a document type, which no Metashape export does; {EXPORT}")

    def start(self, tag: str, attributes: dict[str, str], /) -> ElementTree.Element:
        self.count, self.depth = self.count + 1, self.depth + 1
        if self.count > MOST_ELEMENTS or self.depth > DEEPEST:
            raise BadInput(f"{self.path}: has more or deeper elements than a Metashape export has; {EXPORT}")
        return super().start(tag, attributes)

    def end(self, tag: str, /) -> ElementTree.Element:
        self.depth -= 1
        return super().end(tag)


def read_metashape(path: Path) -> Project:
    """The project in ``path``.  Raises BadInput."""
    chunk = _chunk(path)
    draft = Draft(path, "Metashape")
    sensors = {sensor.get("id", ""): sensor for sensor in chunk.iterfind("sensors/sensor")}
    frames = _frames(chunk, draft)
    for element in chunk.iterfind("cameras//camera"):
        name = element.get("label", "")
        why = _missing(element) or _unusable(sensors.get(element.get("sensor_id", "")))
        frame = frames.get(element.get("component_id"), frames.get(None))
        if why is None and frame is None:
            why = "its component has no place among the others; align or merge the components"
        if why is not None or frame is None:
            draft.left_out.append((name, str(why)))
            continue
        which = element.get("sensor_id", "")
        lens = draft.lens(which, name, _lens, sensors.get(which), draft.camera(name))
        if lens is None:
            continue
        matrix = numbers(element.findtext("transform"), (4, 4), draft.camera(name), "its transform")
        draft.add(name, lens, frame.rotation @ matrix[:3, :3],
                  frame.scale * frame.rotation @ matrix[:3, 3] + frame.translation)
    return draft.finished()


def _chunk(path: Path) -> ElementTree.Element:
    try:
        root = ElementTree.fromstring(read_text(path), ElementTree.XMLParser(target=_Builder(path)))
    except (ElementTree.ParseError, ValueError) as error:
        raise BadInput(f"{path}: is not complete XML ({error}); {EXPORT}") from None
    chunks = root.findall("chunk") if root.tag == "document" else []
    if len(chunks) > 1:
        raise BadInput(f"{path}: has {len(chunks)} chunks; export the cameras of one of them")
    if not chunks or chunks[0].find("cameras") is None:
        raise BadInput(f"{path}: is not a Metashape project; {EXPORT}")
    return chunks[0]


def _missing(element: ElementTree.Element) -> str | None:
    """Why a camera has no pose of its own."""
    if element.get("enabled") in ("0", "false"):
        return "it is disabled in Metashape"
    if element.find("transform") is not None:
        return None
    if element.get("master_id") is not None:
        return "it is a slave of a multi-camera system, whose poses cannot be read"
    return "it is not aligned"


def _unusable(sensor: ElementTree.Element | None) -> str | None:
    """Why no picture of a sensor can be used."""
    if sensor is None or _kind(sensor) in ("frame", *FISHEYES):
        return None
    return (f"its sensor is of type '{str(_kind(sensor))[:40]}', and only frame and equidistant fisheye cameras can be "
            "used; align with one of these types")


def _kind(sensor: ElementTree.Element) -> str | None:
    calibration = _calibration(sensor)
    return (None if calibration is None else calibration.get("type")) or sensor.get("type")


def _calibration(sensor: ElementTree.Element) -> ElementTree.Element | None:
    """The adjusted one, else the first."""
    calibrations = sensor.findall("calibration")
    return next((each for each in calibrations if each.get("class") == "adjusted"), next(iter(calibrations), None))


def _frames(chunk: ElementTree.Element, draft: Draft) -> dict[str | None, _Similarity | None]:
    """What leads from each component to the world; None: the chunk, for cameras without component."""
    own = _similarity(chunk.find("transform"), draft.path)
    components = chunk.findall("components//component")  # perhaps in groups
    active = next((each.get("active_id") for each in chunk.iterfind("components")), None)
    frames: dict[str | None, _Similarity | None] = {}
    for component in components:
        found = _similarity(component.find("transform"), draft.path)
        if found is None and (len(components) == 1 or component.get("id") == active):
            found = own or _Similarity(np.eye(3), np.zeros(3), 1.0, False)
        frames[component.get("id")] = found
    frames[None] = whole = own or frames.get(active) or _Similarity(np.eye(3), np.zeros(3), 1.0, False)
    reference = chunk.findtext("reference") or ""
    geographic = bool(reference.strip()) and not reference.lstrip().startswith("LOCAL_CS")
    if geographic:
        draft.warnings.append("the project has geographic coordinates, its cameras Earth-centred ones; give the chunk "
                              "local coordinates in Metashape and export cameras and mesh again")
    if whole is not None and whole.scaled:
        unit = None if geographic else re.search(r'UNIT\["[^"]{0,80}",\s*([0-9.eE+-]{1,30})', reference)
        draft.metres_per_unit = number(unit[1], str(draft.path), "its unit") if unit else 1.0
    return frames


def _similarity(element: ElementTree.Element | None, path: Path) -> _Similarity | None:
    if element is None:
        return None
    who = f"{path}: the chunk's or a component's transform"
    rotation, translation = element.findtext("rotation"), element.findtext("translation")
    scale = element.findtext("scale")
    if rotation is None and translation is None and scale is None:
        return None
    found = _Similarity(
        np.eye(3) if rotation is None else numbers(rotation, (3, 3), who, "its rotation"),
        np.zeros(3) if translation is None else numbers(translation, (3,), who, "its translation"),
        1.0 if scale is None else number(scale, who, "its scale"), scale is not None)
    if found.scale <= 0:
        raise BadInput(f"{who} has scale {found.scale:g}; export the cameras again")
    return found


def _lens(sensor: ElementTree.Element | None, who: str) -> Lens:
    """The adjusted calibration of a sensor.  Raises Unusable, and BadInput for numbers that are none."""
    calibration = None if sensor is None else _calibration(sensor)
    if sensor is None or calibration is None:
        raise Unusable(f"its sensor has no calibration; align these pictures too, and {EXPORT}")
    if calibration.find("f") is None:
        raise Unusable("its calibration has no f, as before PhotoScan 1.2; open the project in Metashape, then "
                       f"{EXPORT}")

    def value(tag: str) -> float:
        text = calibration.findtext(tag)
        return 0.0 if text is None else number(text, who, tag)

    if value("p3") or value("p4"):
        raise Unusable(f"its lens uses p3 and p4; align the pictures without them and {EXPORT}")
    resolution = calibration.find("resolution")
    pixels = sensor.find("resolution") if resolution is None else resolution
    if pixels is None:
        raise Unusable(f"its sensor has no resolution; {EXPORT}")
    width, height = size(pixels.get("width"), pixels.get("height"), who)
    return checked(Lens(
        width, height, fx=value("f") + value("b1"), fy=value("f"), cx=width / 2 + value("cx"),
        cy=height / 2 + value("cy"), radial=(value("k1"), value("k2"), value("k3"), value("k4")),
        tangential=(value("p2"), value("p1")), skew=value("b2"), fisheye=_kind(sensor) in FISHEYES), who)
