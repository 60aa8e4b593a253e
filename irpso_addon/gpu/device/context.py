"""The one OpenGL context of the process, drawing: shaders run on targets, kernels as fragment or compute shaders.

Only the GL thread (gpu/device/thread.py) may create or use a Device, see memory.py.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Protocol

import moderngl

from ...core.data import F32
from ...core.errors import BadInput, ShaderRefused
from ...core.params import DeviceSettings
from .draw_budget import DrawBudget, Rectangle, rectangles
from .memory import DeviceMemory
from .programs import WORKGROUP

COMPUTE_GAIN = 1.5  # how many times faster compute shaders must be to be taken
Textures = moderngl.Texture | tuple[moderngl.Texture, ...] | None


class DrawnCells(Protocol):
    """Part of a target that a draw is limited to: squares of pixels (occupied_cells.py)."""

    count: int

    @property
    def pixels_each(self) -> int:
        """Pixels of a square."""
        ...

    @property
    def uniforms(self) -> Mapping[str, Any]:
        """Of include/occupied_cells.vert."""
        ...

    def render(self, program: moderngl.Program, first: int, count: int) -> None:
        """Run a program made with include/occupied_cells.vert on every pixel of some of the squares."""
        ...


@dataclass(frozen=True)
class Inputs:
    """What a shader is given."""

    textures: Mapping[str, Textures] = field(default_factory=dict)  # by the sampler's name
    uniforms: Mapping[str, Any] = field(default_factory=dict)
    defines: Mapping[str, str] = field(default_factory=dict)  # with which its program is made


class Device(DeviceMemory):
    """A moderngl context with its programs and a full-screen triangle.

    Whatever draws or makes textures raises OutOfDeviceMemory or DeviceLost when it is so.
    """

    def __init__(self) -> None:
        """Raises NoDevice."""
        super().__init__()
        self.settings = DeviceSettings()
        self.compute_faster: bool | None = None  # compute shaders than fragment shaders; None until measured
        self.budget = DrawBudget(self._finish, self.settings.slice)
        self._quads: dict[int, moderngl.VertexArray] = {}

    def collect(self) -> None:
        """Between two jobs: free what an error or a stop left behind, and programs that were not used for long."""
        super().collect()
        gone = self.programs.give_back()
        if gone:
            self.budget.forget(lambda key: isinstance(key, tuple) and key[1] in gone)
        for name in gone & self._quads.keys():
            self._quads.pop(name).release()

    def configure(self, settings: DeviceSettings) -> None:
        """How the device is used from now on.  Raises BadInput where it cannot do that."""
        if settings.kernels == "compute" and self.ctx.version_code < 430:
            raise BadInput(f"Shaders Compute: {self.name} has OpenGL {self.ctx.version_code / 100}, "
                           "but compute shaders need 4.3; set Shaders to Auto or Fragment")
        self.settings = settings
        self.budget.choose(settings.slice)

    def bind(self, program: moderngl.Program | moderngl.ComputeShader, textures: Mapping[str, Textures]) -> None:
        """Bind textures to consecutive units, by sampler name; a tuple fills an array of samplers."""
        unit = 0
        for name, value in textures.items():
            several = value if isinstance(value, tuple) else (value,)
            for texture in several:
                if texture is not None:
                    texture.use(unit + several.index(texture))
            if several[0] is not None:
                units = tuple(range(unit, unit + len(several)))
                self.programs.set(program, {name: units if len(units) > 1 else unit})
            unit += len(several)

    def draw(
        self, fragment: str, target: moderngl.Framebuffer, inputs: Inputs, *, viewport: Rectangle | None = None,
        cells: DrawnCells | None = None,
    ) -> None:
        """Run ``shaders/<fragment>`` once for every pixel of the target, or of its viewport, or of ``cells`` of it."""
        vertex = "include/occupied_cells.vert" if cells else "include/screen.vert"
        program = self.programs.get(vertex, fragment, {**inputs.defines, **self._variant(inputs.textures)})
        key = fragment, program.glo, target.size
        whole = viewport or (0, 0, target.width, target.height)
        self.bind(program, inputs.textures)
        self.programs.set(program, inputs.uniforms)
        target.use()
        if cells:
            self.ctx.viewport = whole
            self.programs.set(program, cells.uniforms)
            first = 0
            while first < cells.count:
                count = int(min(max(self.budget.most(key) / cells.pixels_each, 1), cells.count - first))
                with self.budget.piece(key, count * cells.pixels_each):
                    cells.render(program, first, count)
                first += count
            return
        for part, pixels in rectangles(whole, lambda: self.budget.most(key)):
            with self.budget.piece(key, pixels):
                self._fill(program, part)

    def _fill(self, program: moderngl.Program, viewport: Rectangle) -> None:
        if program.glo not in self._quads:
            self._quads[program.glo] = self.ctx.vertex_array(program, [])
        self.ctx.viewport = viewport
        self._quads[program.glo].render(moderngl.TRIANGLES, vertices=3)

    def _variant(self, textures: Mapping[str, Textures]) -> dict[str, str]:
        """A define that tells a program for textures of one kind from the same program for those of another.

        Mesa's software renderer compiles for whether a texture's sides are powers of two, and its cache on disk keeps
        what a program was compiled to first, but nothing that it was compiled to later (decision 0044).
        """
        if not self.is_software:
            return {}
        sides = (side for value in textures.values() for texture in (value if isinstance(value, tuple) else (value,))
                 if texture is not None for side in texture.size)
        return {"VARIANT": "V" + "".join("01"[side & (side - 1) == 0] for side in sides)}

    def kernel(self, name: str, target: moderngl.Framebuffer, inputs: Inputs, region: Rectangle) -> None:
        """Run the kernel ``shaders/<name>`` on a region (x, y, width, height) of the target's textures.

        As a compute shader where that is faster on this device (``prefers_compute``), else as a fragment shader.
        """
        for _ in self.steps(name, target, inputs, region):
            pass

    def steps(
        self, name: str, target: moderngl.Framebuffer, inputs: Inputs, region: Rectangle, work: F32 | None = None,
    ) -> Iterator[None]:
        """The same in pieces of about a slice, between which others may draw.

        ``work``: how much each row of the region asks for, in any unit that is the same for all calls of this kernel;
        None: its pixels.
        """
        outputs = target.color_attachments
        defines = {**inputs.defines, **self._variant(inputs.textures), "OUTPUTS": str(len(outputs))}
        program = self._kernel_program(name, defines)
        key = name, program.glo, target.size
        for part, units in rectangles(region, lambda: self.budget.most(key), work):
            self.bind(program, inputs.textures)
            self.programs.set(program, inputs.uniforms)
            target.use()
            with self.budget.piece(key, units):
                if isinstance(program, moderngl.Program):
                    self._fill(program, part)
                else:
                    self.programs.set(program, {"u_region": part})
                    for unit, texture in enumerate(outputs):
                        assert isinstance(texture, moderngl.Texture)
                        texture.bind_to_image(unit, read=False, write=True)
                    program.run(-(-part[2] // WORKGROUP), -(-part[3] // WORKGROUP))
                    self.ctx.memory_barrier()
            yield

    def _kernel_program(self, name: str, defines: Mapping[str, str]) -> moderngl.Program | moderngl.ComputeShader:
        if self.prefers_compute:
            try:
                return self.programs.compute(name, defines)
            except ShaderRefused:
                if self.settings.kernels == "compute":
                    raise
                self.compute_faster = False
        return self.programs.get("include/screen.vert", name, defines)

    @property
    def prefers_compute(self) -> bool:
        """Whether kernels run as compute shaders: as the settings say, or where that is clearly faster.

        Measured once, by the same arithmetic both ways.  Data-centre GPUs have few graphics units (30 times
        slower there); elsewhere the two are alike, and fragment shaders run everywhere.  A software renderer has the
        same processor for both: there it would be time lost.
        """
        if self.settings.kernels != "auto" or self.ctx.version_code < 430:
            return self.settings.kernels == "compute"
        if self.compute_faster is None:
            self.compute_faster = not self.is_software and self._measure_compute()
        return self.compute_faster

    def _measure_compute(self) -> bool:
        size = 512
        seconds = []
        self.budget.choose(math.inf)
        try:
            with self.scope():
                target = self.framebuffer([self.texture(size, size)])
                for compute in (False, True):
                    self.compute_faster = compute
                    seconds.append(self._probe(target, size))
        finally:
            self.compute_faster = None  # not known until this returns
            self.budget.choose(self.settings.slice)
        return seconds[1] * COMPUTE_GAIN < seconds[0]

    def _probe(self, target: moderngl.Framebuffer, size: int) -> float:
        """Seconds of a kernel on the whole target."""
        taken = []
        for _ in range(4):  # the first compiles and warms up
            start = time.perf_counter()
            self.kernel("device/compute_probe.kernel", target, Inputs(uniforms={"u_steps": 64}),
                        (0, 0, size, size))
            self.budget.finish()
            taken.append(time.perf_counter() - start)
        return min(taken[1:])

    @contextmanager
    def adding(self) -> Iterator[None]:
        """Draws add to what the target holds."""
        with self._blending(moderngl.FUNC_ADD):
            yield

    @contextmanager
    def keeping_least(self) -> Iterator[None]:
        """Draws leave the least of theirs and what the target holds."""
        with self._blending(moderngl.MIN):
            yield

    @contextmanager
    def _blending(self, equation: int) -> Iterator[None]:
        self.ctx.enable(moderngl.BLEND)
        self.ctx.blend_func = (moderngl.ONE, moderngl.ONE)
        self.ctx.blend_equation = equation  # type: ignore[assignment]  # the stub knows pairs alone
        try:
            yield
        finally:
            self.ctx.blend_equation = moderngl.FUNC_ADD  # type: ignore[assignment]
            self.ctx.disable(moderngl.BLEND)

    @contextmanager
    def leaving_out(self, faces: str) -> Iterator[None]:
        """Draws leave out the ``front`` or the ``back`` of triangles: fronts have their corners anticlockwise."""
        self.ctx.cull_face = faces
        self.ctx.enable(moderngl.CULL_FACE)
        try:
            yield
        finally:
            self.ctx.disable(moderngl.CULL_FACE)

    @contextmanager
    def keeping_nearest(self) -> Iterator[None]:
        """Draws are hidden by what is nearer in the target's depth map."""
        self.ctx.enable(moderngl.DEPTH_TEST)
        try:
            yield
        finally:
            self.ctx.disable(moderngl.DEPTH_TEST)
