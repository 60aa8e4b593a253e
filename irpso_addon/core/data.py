"""What passes between the stages: frozen records of arrays.

Conventions, everywhere in memory: world space is Blender's (metres, Z up); colours are scene-linear
Rec.709; **row 0 of every image and map is the bottom** (v = 0), as in OpenGL and in Blender's own
pixels.  Files have row 0 at the top: only ``core/images/reference_image.py`` and ``core/images/image_writer.py`` flip.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .change_records import Calibration, CameraChange, PredictionError, RefinedNormals
from .check_records import Checks
from .lens import Lens

ONE_VALUE = 1e5  # strength of a material's prior that leaves its texels no choice
ONE_BASE = 1e6  # observations for which a base colour counts that leaves texels no choice
F16 = NDArray[np.float16]
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]
Bool = NDArray[np.bool_]


@dataclass(frozen=True)
class NormalMap:
    """A tangent-space normal map that a material slot already uses."""

    pixels: F32  # (h, w, 3) raw values in 0..1 as stored, row 0 bottom
    strength: float  # the Normal Map node's Strength
    # Whether the interpolated normal is made unit length before it is combined (tangents never are): Cycles 5 does
    # so, 4.5 does not, and low-poly meshes show the difference (5 degrees on a cone of seven sides).
    unit_normal: bool = False


@dataclass(frozen=True)
class MeshArrays:
    """Triangles of the evaluated object (T of them, three corners each)."""

    name: str  # the object's name, the stem of every file written
    positions: F32  # (T, 3, 3) world, metres
    normals: F32  # (T, 3, 3) world, unit: corner normals transformed, THEN normalised
    uvs: F32  # (T, 3, 2) active UV map
    slots: I32  # (T,) material slot of each triangle
    slot_names: tuple[str, ...]  # material name per slot ("" for an empty slot)
    # Only where some slot has a normal map (else None / empty):
    object_normals: F32 | None = None  # (T, 3, 3) object space, unit corner normals
    tangents: F32 | None = None  # (T, 3, 4) object space MikkTSpace tangent xyz, w = bitangent sign
    normal_maps: dict[int, NormalMap] = field(default_factory=dict)  # slot -> map
    # Always where the mesh is an object's:
    normal_matrix: F32 | None = None  # (3, 3) inverse transpose of the object's 3x3 world matrix; None: of no turn
    unit_normal: bool = False  # as of `NormalMap`
    grid: F32 | None = None  # (T, 3, 2) where triangles lie on the texel grid, 0..1, where that is not their UVs
    extent: float = 1.0  # width of the texel grid in UV squares


@dataclass(frozen=True)
class Camera:
    """A camera as OpenGL sees it; holds for perspective and orthographic, shift, any sensor fit."""

    name: str
    world_to_camera: F64  # (4, 4) rigid (scale removed); the camera looks along its -Z
    projection: F64  # (4, 4) OpenGL clip matrix; its near/far rows are replaced when drawn
    position: F64  # (3,) world
    forward: F64  # (3,) world, unit
    orthographic: bool
    aspect: float  # image width / height in pixels that the projection was made for
    whole: Camera | None = None  # the camera of which this one is a part ...
    part: tuple[float, float, float, float] = (0.0, 0.0, 1.0, 1.0)  # ... : x, y, width, height, of 1
    lens: Lens | None = None  # of a perspective camera, where it bends lines; then ``projection`` is its matrix
    kept: bool = False  # place and lens were measured: a solve changes neither


@dataclass(frozen=True)
class Light:
    """A lamp.  ``power`` already holds exposure, colour, temperature and `normalize` off."""

    name: str
    kind: str  # "POINT", "SUN", "SPOT", "AREA"
    power: F64  # (3,) linear RGB: watts (SUN: W/m^2)
    matrix: F64  # (4, 4) object to world, scale included; emits along its local -Z
    radius: float = 0.0  # POINT, SPOT: metres; SUN: half angle in radians
    soft_falloff: bool = True  # POINT, SPOT: the emitter is a disc facing the texel (Blender's default)
    spot_angle: float = 0.0  # SPOT: full cone, radians
    spot_blend: float = 0.0  # SPOT: 0..1
    shape: str = "SQUARE"  # AREA: SQUARE, RECTANGLE, DISK, ELLIPSE
    size: tuple[float, float] = (1.0, 1.0)  # AREA: metres along local X and Y, before the object's scale
    spread: float = np.pi  # AREA: full angle, radians
    cast_shadow: bool = True
    kept: bool = False  # place and power were measured: a solve changes neither


@dataclass(frozen=True)
class Emitter:
    """A mesh that glows: each face sends the same radiance in all directions."""

    name: str  # of the object
    triangles: F32  # (T, 3, 3) world, metres; counter-clockwise from the front
    radiance: F32  # (T, 3) W/(m^2 sr), linear RGB
    both_sides: bool = True  # False: a closed shape, whose inside nobody sees


@dataclass(frozen=True)
class Environment:
    """Light that no lamp sends: from far away, the same at every place, and from meshes that glow."""

    name: str  # of the world; "" where there are emitters alone
    radiance: F32  # (h, w, 3) linear, equirectangular as Blender maps it, row 0 straight down; W/(m^2 sr)
    rotation: F64  # (3, 3) directions in the world to directions in the picture
    turn: float = 0.0  # radians about Z of it that a view asked for
    emitters: tuple[Emitter, ...] = ()  # each name once

    @property
    def key(self) -> tuple[str, float, tuple[str, ...]]:
        """The same for views under the same light."""
        return *self.world, tuple(emitter.name for emitter in self.emitters)

    @property
    def world(self) -> tuple[str, float]:
        """The same for views under the same world and turn."""
        return self.name, self.turn

    @property
    def title(self) -> str:
        """For messages."""
        return f"world '{self.name}'" if self.name else f"object '{self.emitters[0].name}'"


@dataclass(frozen=True)
class View:
    """One reference image with the camera and the lights it was taken under."""

    image: Path
    camera: Camera
    lights: tuple[Light, ...]
    exposure: float = 0.0  # EV; image = radiance * 2^exposure
    mask: Path | None = None
    colorspace: str | None = None  # of the file's values; None: by file type (float linear, integer sRGB)
    gain: float = 1.0  # further factor from radiance to image (Cycles' film exposure)
    vignetting: float = 0.0  # power of the cosine of the angle to the camera's axis by which the image is darker
    ambient: Path | None = None  # the same picture without these lights: subtracted
    flat: Path | None = None  # a picture of an even surface through the same lens: what it falls off is divided out
    # Factors of red, green and blue for RAW files, the same in all views; None: those that the file says
    white_balance: tuple[float, float, float] | None = None
    full_raw: bool = False  # RAW files: a pixel for each sample, not binned
    environment: Environment | None = None  # shines beside the lights
    # Factors of red, green and blue, in linear Rec.709, by which the picture's white balance makes it brighter
    tint: tuple[float, float, float] = (1.0, 1.0, 1.0)
    response: float = 1.0  # the file holds radiance to this power; 1: it is linear ...
    shoulder: float = 1.0  # ... in the dark: at white its curve is so many times flatter
    # Values of the file, in linear Rec.709, where no light falls: subtracted before ``response`` is undone
    black_level: tuple[float, float, float] = (0.0, 0.0, 0.0)
    # Light from all around, alike from everywhere, that shines beside the lights: W/(m^2 sr), linear RGB
    ambient_radiance: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def light_names(self) -> tuple[str, ...]:
        """Its lamps and the meshes that glow."""
        emitters = self.environment.emitters if self.environment is not None else ()
        return tuple(light.name for light in self.lights) + tuple(emitter.name for emitter in emitters)

    @property
    def files(self) -> tuple[Path, ...]:
        """All that its radiance is read from."""
        return tuple(path for path in (self.image, self.mask, self.ambient, self.flat) if path is not None)


@dataclass(frozen=True)
class Region:
    """The part of a mesh that is to be solved: where one of the two is above a half."""

    corners: F32 | None = None  # (T, 3) 0..1, interpolated over the triangles
    image: F32 | None = None  # (h, w) 0..1 over the UV square, row 0 at the bottom


@dataclass(frozen=True)
class SceneData:
    """Everything a solve needs, free of Blender."""

    name: str  # stem of the .blend, for <scene>_irpso.blend
    mesh: MeshArrays
    occluders: F32  # (O, 3, 3) world triangles of the other renderable meshes that cameras see
    views: tuple[View, ...]
    pixel_filter: float = 1.0  # width in pixels of the box over which a pixel averages (1: a sensor)
    warnings: tuple[str, ...] = ()
    skipped: tuple[tuple[str, str], ...] = ()  # (view, why) of views left out
    scale_known: bool = True  # the lamps' powers are those of the pictures; else right but for one common factor
    region: Region | None = None  # None: all of the mesh
    start: Solution | None = None  # the last result: kept where the region is not, and where a search may begin
    unseen: F32 = field(default_factory=lambda: np.zeros((0, 3, 3), np.float32))  # the same, hidden from cameras

    @property
    def casters(self) -> F32:
        """(O, 3, 3) world triangles of whatever stands in the way of light, besides the mesh."""
        return np.concatenate([self.occluders, self.unseen]) if len(self.unseen) else self.occluders


SOLID = 0.5  # coverage: a pixel of no more is an edge, and no observation
OPAQUE = 0.95  # coverage of a pixel that shows the object alone: masks are seldom quite white


@dataclass(frozen=True)
class RadianceImage:
    """A reference image, ready to use.  ``rgb`` is radiance, W/(m^2 sr), not premultiplied."""

    # (h, w, 3) linear; finite; slightly negative where noise or a colour space makes it so.  Where not valid: what the
    # surface shows at least, of a clipped pixel, or 0.
    rgb: F32
    coverage: F32  # (h, w) 0..1: alpha times mask; 1 where the file has neither
    valid: Bool  # (h, w) False: clipped, NaN or infinite
    warnings: tuple[str, ...] = ()
    clipped_share: float = 0.0  # share of pixels that are clipped


@dataclass(frozen=True)
class Bounced:
    """Light that reaches a view's pixels by way of other surfaces; row 0 at the bottom, of the image's aspect."""

    irradiance: F32  # (h, w, 3) on the surface, W/m^2
    glossy: F32  # (h, w, 3) what highlights of it add to the picture, W/(m^2 sr)


@dataclass(frozen=True)
class Maps:
    """The result, row 0 at the bottom (v = 0), holes filled and seams padded."""

    base_color: F32  # (n, n, 3) linear
    roughness: F32  # (n, n) perceptual, 0..1; of the sharper lobe where there are two
    confidence: F32  # (n, n) 0..1; 0 where filled
    error: F32  # (n, n) weighted relative residual of the fit; 0 where filled
    filled: Bool  # (n, n) True: covered or padded texels whose value came from neighbours
    coverage: Bool  # (n, n) True: inside a UV island
    roughness_sigma: F32  # (n, n) standard error of roughness; 0 where filled
    base_sigma: F32  # (n, n) standard error of base color, the mean of its channels, linear; 0 where filled
    # Only where the model of some material has them, else None:
    lobes: F32 | None = None  # (n, n, 3) roughness1 <= roughness2 and the weight of lobe 1; (r, r, 1) for one lobe
    specular: F32 | None = None  # (n, n) Specular IOR Level, 0..1; 0.5 where it was not solved for
    metallic: F32 | None = None  # (n, n) where some material is in part metal and in part paint; 0 on the paint
    normal: F32 | None = None  # (n, n, 3) tangent-space normal map, 0..1, green up; where normals were refined


@dataclass(frozen=True)
class ViewPicture:
    """A view's reference and what the maps predict, in the part of the picture that shows the object; row 0 bottom.

    Both are radiance over ``scale``; pixels that one of them says nothing of are NaN.
    """

    view: str  # file name of the reference
    camera: str
    lights: tuple[str, ...]
    reference: F16  # (h, w, 3)
    predicted: F16  # (h, w, 3)
    scale: float  # W/(m^2 sr) of the value 1


@dataclass(frozen=True)
class Coat:
    """A clear, colourless layer above a material, the same everywhere: the Principled BSDF's at Coat IOR 1.5."""

    weight: float  # Coat Weight, 0..1
    roughness: float  # Coat Roughness, 0..1


@dataclass(frozen=True)
class JointPrior:
    """What a material as a whole says of its texels' roughness, level and base colour: the first two are normal about
    it, in the logarithm.

    Or about one of several values, where parts of the material differ.
    """

    roughness: float
    strength: float  # nats that a texel pays per squared log ratio; ONE_VALUE and more: all texels have that roughness
    sigma: float = 0.0  # what it is off by at a texel (standard error), where all texels have that one
    others: tuple[float, ...] = ()  # roughnesses that some texels lie about instead, at most two
    level: float = 0.5  # Specular IOR Level of the material, about which those of its texels are normal in the same way
    level_strength: float = 0.0  # nats per squared log ratio of levels; 0: all texels have the material's
    base: tuple[float, ...] = ()  # base colour of the material, RGB, to which texels are drawn; (): they are not
    base_strength: float = 0.0  # good observations of a texel for which it counts

    @property
    def one_value(self) -> bool:
        """Whether all texels have that roughness."""
        return self.strength >= ONE_VALUE


@dataclass(frozen=True)
class MaterialPrediction:
    """How well models of one material predicted what lamps (or cameras) that were left out show."""

    left_out: str  # "lamps" or "cameras"
    taken: str  # the row of ``tried`` that was solved for
    tried: dict[str, PredictionError]  # from the smallest model on
    clear: bool = True  # whether the model that the fit prefers leads clearly: in its own world it does
    broad_metal: bool = False  # what was taken is a metal whose lobe is as broad as there is: no metal is
    by_light: float = 0.0  # power of the irradiance by which observations count in base colour
    noise_by_light: float = 1.0  # how much more of the noise base colour has by that

    @property
    def error(self) -> PredictionError:
        """Of what was taken."""
        return self.tried[self.taken]

    @property
    def fits(self) -> bool:
        """Whether the model explains the material at all."""
        return self.error.fits and not self.broad_metal


@dataclass(frozen=True)
class Solution:
    """Maps with what the report says of them."""

    maps: Maps
    model: dict[str, str]  # material slot name -> one of core/params.py's models
    why: dict[str, str]  # material slot name -> why that model
    texels: dict[str, int]  # covered, observed, solved, filled; kept: of the last result, outside the region
    seconds: dict[str, float]  # per stage
    residual: float  # weighted RMS relative residual over solved texels
    views_used: tuple[str, ...]
    views_skipped: tuple[tuple[str, str], ...]
    warnings: tuple[str, ...]
    device: dict[str, Any]  # GL renderer, vendor, version
    cancelled: bool = False  # True: only part of the texels was solved
    # material slot name -> its one Specular IOR Level, where a single value was solved for the material
    levels: dict[str, float] = field(default_factory=dict)
    metallic: dict[str, float] = field(default_factory=dict)  # material slot name -> Metallic, where its model has it
    # material slot name -> share of its texels that are paint beside its metal; where there are any, Metallic is a map
    paint: dict[str, float] = field(default_factory=dict)
    coats: dict[str, Coat] = field(default_factory=dict)  # material slot name -> its coat, where it has one
    diffuse_roughness: dict[str, float] = field(default_factory=dict)  # material slot name -> that, where it is not 0
    ndf: str = "ggx"  # distribution of the two-lobe model, as in core/params.py
    checks: Checks | None = None  # what the views say of the maps
    pictures: tuple[ViewPicture, ...] = ()  # of each view, reduced: reference beside prediction
    predictions: dict[str, MaterialPrediction] = field(default_factory=dict)  # material slot name -> errors of models
    priors: dict[str, JointPrior] = field(default_factory=dict)  # material slot name -> what its texels were drawn to
    calibration: Calibration | None = None  # light and exposures that were put right; None: they are as given
    cameras: tuple[CameraChange, ...] = ()  # that were put right
    normals: RefinedNormals | None = None  # shading normals that were refined; None: they are as given
    normals_why: str = ""  # why they are as given; "": they were refined, or not to be
    stride: int = 1  # every how many-th texel of a row and column was searched, see core/maps/stride.py
    resumed_blocks: int = 0  # of a solve in blocks: those that an earlier run had left

    @property
    def put_right(self) -> bool:
        """Whether the scene's cameras, its light or its exposures were."""
        return self.calibration is not None or bool(self.cameras)

    @property
    def for_scene(self) -> bool:
        """Whether some of it can be given to the scene: a view that departs has no camera of its own there."""
        return self.calibration is not None or any(change.image is None for change in self.cameras)

    @classmethod
    def of_maps(
        cls, maps: Maps, model: dict[str, str], levels: dict[str, float] | None = None, ndf: str = "ggx", why: str = "",
        metallic: dict[str, float] | None = None, coats: dict[str, Coat] | None = None,
        paint: dict[str, float] | None = None, diffuse_roughness: dict[str, float] | None = None,
    ) -> Solution:
        """Of maps that no solve here has found: what materials show, and a search may start from; no figures.

        ``why``: of each material's model.
        """
        return cls(maps=maps, model=model, why=dict.fromkeys(model, why), texels={}, seconds={}, residual=0.0,
                   views_used=(), views_skipped=(), warnings=(), device={}, levels=levels or {},
                   metallic=metallic or {}, coats=coats or {},
                   diffuse_roughness=diffuse_roughness or {}, paint=paint or {}, ndf=ndf)
