"""Kernels run over the tiles of a source: tiles bound the memory of gathered observations, and the time of a draw."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial

import moderngl

from ...core.data import F32, Bool, Coat
from ...core.errors import Cancelled
from ...core.job import Progress
from ...core.params import SolveSettings
from ..device.context import Device, Inputs, Textures
from ..observe.observation_atlas import AT_ONCE, ObservationAtlas, Source, Tile
from .live_readback import LOOKS

LEVEL_KERNELS = ("solve/level.kernel", "solve/level_costs.kernel")  # which try Specular IOR Levels of their own
# At most so many times a kernel loops over its groups: evaluations of the model, times the loops of each.
PLAIN, LEVELS, METAL, TWO = 33 * 2, 65 * 2, 33 * 7, 100 * 2
ROBUST, ROBUST_METAL = 33 * 12, 33 * 17
Uniforms = Mapping[str, float | int | tuple[float, ...]]


@dataclass(frozen=True)
class KernelPass:
    """One kernel over all tiles, written in place into whole maps."""

    kernel: str
    outputs: list[moderngl.Texture]
    textures: Mapping[str, Textures]
    uniforms: Uniforms
    lobes: int = 1
    colour: bool = False  # whether it asks for observations of R, G and B
    robust: bool = False  # whether outliers are disbelieved


class TilePasses:
    """Runs kernels over tiles, and holds what every kernel reads."""

    def __init__(
        self, device: Device, source: Source, settings: SolveSettings, tile: tuple[int, int] | None = None,
        start: moderngl.Texture | None = None,
    ) -> None:
        """``start``: where each texel's search begins, as EarlierResult.lobes; it is the caller's."""
        self.device, self.source, self.settings, self.start = device, source, settings, start
        self.atlas = ObservationAtlas(device, source, tile)
        self.slack = 0.0  # between-camera variance of albedo in units of the noise's
        self.level: moderngl.Texture | None = None  # Specular IOR Level of each texel; None: 0.5
        self.position: moderngl.Texture | None = None  # as the source's, of some texels; None: of all
        self.metallic = 0.0
        self.coat: Coat | None = None
        self.diffuse_roughness = 0.0
        self.cancelled = False
        self.shown = True  # whether what kernels find may be looked at; not where something is only tried
        self._work: dict[Tile, F32] = {}  # of each row of a tile, see ObservationAtlas.work

    def use_level(self, level: F32 | None) -> None:
        """Specular IOR Level of each texel from now on, (h, w); None: 0.5."""
        if self.level is not None:
            self.level.release()
        self.level = None if level is None else self.device.texture(level.shape[1], level.shape[0], 1, level)

    def use_texels(self, texels: Bool | None) -> None:
        """Which texels are solved from now on, (h, w); None: all that are covered."""
        if self.position is not None:
            self.position.release()
        self.position = None
        if texels is not None:
            values = self.device.read(self.source.position).copy()
            values[~texels, 3] = 0.0
            self.position = self.device.texture(*self.source.size, data=values)

    def use_metallic(self, metallic: float) -> None:
        """Metallic of all texels from now on, where they are solved for one lobe."""
        self.metallic = metallic

    def use_coat(self, coat: Coat | None) -> None:
        """Coat above all texels from now on, where they are solved for one lobe."""
        self.coat = coat

    def use_diffuse_roughness(self, roughness: float) -> None:
        """Diffuse Roughness of all texels from now on, where they are solved for one lobe without Metallic."""
        self.diffuse_roughness = roughness

    def finishes_robust(self) -> bool:
        """Whether the device finishes kernels that disbelieve outliers, see `Layers.at_once`."""
        loops = ROBUST_METAL if self.metallic > 0.0 else ROBUST
        return not self.device.is_software or self.source.layers.at_once(loops) > 0

    def run(
        self, chosen: list[Tile], span: tuple[float, float], *works: KernelPass,
    ) -> Generator[Progress, None, int]:
        """Run kernels over tiles, each tile gathered once; returns how many were done, fewer when the first is stopped.

        A later kernel goes on to its end over the tiles that the first one did.  ``span``: of the stage's progress.
        ``works``: none needs what another one of them finds; the last may be looked at.
        """
        stoppable, last = span[0] == 0.0, works[-1]
        shown = self.shown and (last.kernel, last.lobes) in LOOKS
        look = partial(LOOKS[last.kernel, last.lobes], self.device, last.outputs) if shown else None
        with ExitStack() as opened:
            runs = [(work, opened.enter_context(self.device.target(work.outputs, clear=True)), self._defines(work))
                    for work in works]
            colour = any("COLOUR" in defines for *_, defines in runs)
            for i, tile in enumerate(chosen):
                for step in (self.source.gather(self.atlas, tile, colour),
                             *(self._run_tile(work, target, tile, defines) for work, target, defines in runs)):
                    for _ in step:
                        try:
                            part = (i + 1) / len(chosen)
                            yield Progress(span[0] + (span[1] - span[0]) * part, "solve",
                                           f"tile {i + 1} of {len(chosen)}", look)
                        except Cancelled:
                            self.cancelled = True
                if self.cancelled and stoppable:
                    return i + 1
            return len(chosen)

    def _defines(self, work: KernelPass) -> dict[str, str]:
        metal = work.lobes == 1 and self.metallic > 0.0
        at_once = self.source.layers.at_once(_loops(work, metal)) if self.device.is_software else 1
        defines = {**self.source.layers.defines(at_once or AT_ONCE[-1]), "LOBES": str(work.lobes)}
        level_searched = work.kernel in LEVEL_KERNELS
        rough = work.lobes == 1 and self.diffuse_roughness > 0.0
        tinted = self.source.layers.channels == 1
        switches = {"COLOUR": work.colour or ((metal or rough) and tinted), "STARTED": "u_started" in work.uniforms,
                    "SPECULAR": self.level is not None or level_searched, "LEVEL_SEARCHED": level_searched,
                    "METALLIC": metal, "TINTED": metal and tinted, "TILTS": self.source.tilts is not None,
                    "COAT": work.lobes == 1 and self.coat is not None, "ROUGH_DIFFUSE": rough,
                    "ROBUST": work.robust, "JOINT": "u_joint_strength" in work.uniforms,
                    "NDF_BECKMANN": work.lobes == 2 and self.settings.ndf == "beckmann"}
        if work.uniforms.get("u_moves"):
            defines["SWARM"] = str(work.uniforms["u_particles"])
        return {**defines, **{name: "1" for name, on in switches.items() if on}}

    def _run_tile(
        self, work: KernelPass, target: moderngl.Framebuffer, tile: Tile, defines: Mapping[str, str],
    ) -> Iterator[None]:
        """One kernel over one tile, a slice at a time."""
        (x, y), (width, height) = tile, self.source.size
        if tile not in self._work:
            self._work[tile] = self.atlas.work()
        region = x, y, min(self.atlas.tile[0], width - x), min(self.atlas.tile[1], height - y)
        yield from self.device.steps(work.kernel, target, Inputs({
            "u_texel_position": self.position or self.source.position, "u_observations": self.atlas.texture,
            "u_principled_table": self.source.principled_table,
            **(self.source.tilts.textures() if self.source.tilts else {}),
            **({"u_level": self.level} if self.level and "LEVEL_SEARCHED" not in defines else {}),
            **({"u_start": self.start} if "STARTED" in defines else {}), **work.textures,
        }, {**self.atlas.uniforms, "u_group_slack": self.slack, "u_tile": tile,
            **({"u_tilt": self.source.tilts.deviation} if self.source.tilts and "u_tried" not in work.uniforms else {}),
            **({"u_metallic": self.metallic} if "METALLIC" in defines else {}),
            **({"u_coat": (self.coat.weight, self.coat.roughness)} if self.coat and "COAT" in defines else {}),
            **({"u_diffuse_roughness": self.diffuse_roughness} if "ROUGH_DIFFUSE" in defines else {}),
            **work.uniforms}, defines),
            region, self._work[tile][:region[3]])

    def textures(self, count: int) -> list[moderngl.Texture]:
        """Of the maps' size."""
        return [self.device.texture(*self.source.size) for _ in range(count)]


def _loops(work: KernelPass, metal: bool) -> int:
    """How often, at most, a kernel loops over its groups."""
    if work.lobes == 2:
        return TWO
    if work.kernel in LEVEL_KERNELS:
        return METAL if metal else LEVELS
    return {(False, False): PLAIN, (True, False): ROBUST, (False, True): METAL, (True, True): ROBUST_METAL}[
        work.robust, metal]
