"""The one OpenGL context of the process, and the small things every stage needs from it.

Only the GL thread (gpu/device/thread.py) may create or use a Device: on Blender's main thread a
standalone context lands inside Blender's own, and the window goes black or crashes.
"""

from __future__ import annotations

import math
import sys
import time
import weakref
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Protocol, TypeVar

import moderngl
import numpy as np
from numpy.typing import NDArray

from ...core.data import F32
from ...core.errors import BadInput, DeviceError, DeviceLost, NoDevice, OutOfDeviceMemory, ShaderRefused
from ...core.params import DeviceSettings
from .context_check import ContextCheck
from .draw_budget import DrawBudget, Rectangle, rectangles
from .programs import SLOWER, WORKGROUP, Programs, first_line

COMPUTE_GAIN = 1.5  # how many times faster compute shaders must be to be taken
BAD_MATCH = "0x3009"  # EGL's word for a version that is not there
Made = TypeVar("Made", moderngl.Texture, moderngl.Buffer, moderngl.Framebuffer)
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


class Device:
    """A moderngl context with its programs and a full-screen triangle.

    Whatever draws or makes textures raises OutOfDeviceMemory or DeviceLost when it is so.
    """

    def __init__(self) -> None:
        """Raises NoDevice."""
        try:
            backend: dict[str, Any] = {"backend": "egl"} if sys.platform.startswith("linux") else {}
            self.ctx = moderngl.create_context(standalone=True, require=330, **backend)
        except Exception as error:  # moderngl raises plain Exception, with the platform's words
            why = "the driver's is older" if BAD_MATCH in str(error) else first_line(str(error))
            raise NoDevice(
                f"OpenGL 3.3: no context can be made ({why}); install a graphics driver (on Linux "
                f"also libegl1 and libgl1-mesa-dri, Mesa's software OpenGL), {SLOWER}"
            ) from None
        self.settings = DeviceSettings()
        self.ctx.gc_mode = "context_gc"  # objects dropped on other threads wait for ours
        self.ctx.clear_errors()  # of what the context was asked while it was made
        self.info: dict[str, Any] = self.ctx.info
        self.name: str = self.info["GL_RENDERER"]
        self.lost = False  # whether it is of no more use
        self.compute_faster: bool | None = None  # compute shaders than fragment shaders; None until measured
        self._context_check: ContextCheck | None = None
        self.programs = Programs(self.ctx, self.check_alive)
        self.budget = DrawBudget(self._finish, self.settings.slice)
        self._quads: dict[int, moderngl.VertexArray] = {}
        self._scopes: list[weakref.WeakSet[Any]] = []
        self._context_check = ContextCheck(self.ctx, self.programs)

    def configure(self, settings: DeviceSettings) -> None:
        """How the device is used from now on.  Raises BadInput where it cannot do that."""
        if settings.kernels == "compute" and self.ctx.version_code < 430:
            raise BadInput(f"kernels compute: {self.name} has OpenGL {self.ctx.version_code / 100}, "
                           "compute shaders need 4.3; choose auto or fragment")
        self.settings = settings
        self.budget.choose(settings.slice)

    def describe(self) -> dict[str, Any]:
        """Renderer, vendor and version as the driver names them."""
        return {"renderer": self.name, "vendor": self.info["GL_VENDOR"], "version": self.info["GL_VERSION"]}

    def _finish(self) -> None:
        self.ctx.finish()
        self.check("drawing")

    def check_alive(self) -> None:
        """Raises DeviceLost where the context no longer does what it is told."""
        if self.lost or (self._context_check is not None and not self._context_check.passes()):
            self.lost = True
            raise DeviceLost(f"{self.name}: the graphics driver was reset, or gave up its context; solve again, with a "
                             f"shorter Slice if it happens again, {SLOWER}")

    def check(self, what: str) -> None:
        """Raises OutOfDeviceMemory if OpenGL has reported that; ``what`` was done.

        Other errors may be harmless: moderngl binds again what was bound before, even if it is deleted.
        """
        if self.ctx.error == "GL_OUT_OF_MEMORY":
            raise OutOfDeviceMemory(f"{self.name}: no memory left for {what}; choose a smaller Memory or Size, "
                                    f"{SLOWER}")

    @contextmanager
    def making(self, what: str) -> Iterator[None]:
        """Textures, buffers or framebuffers are made within; raises OutOfDeviceMemory, DeviceLost or DeviceError."""
        try:
            yield
        except moderngl.Error as error:
            self.check(what)
            self.check_alive()
            raise DeviceError(f"{self.name}: {what}: {first_line(str(error))}; update the graphics driver, {SLOWER}"
                              ) from None
        self.check(what)

    def texture(
        self, width: int, height: int, channels: int = 4, data: F32 | None = None, dtype: str = "f4"
    ) -> moderngl.Texture:
        """A texture read by texelFetch only; float32 unless told."""
        most = self.info["GL_MAX_TEXTURE_SIZE"]
        if max(width, height) > most:
            raise OutOfDeviceMemory(f"{self.name}: pictures may have {most} pixels a side, not {width} x {height}; "
                                    "reduce them")
        kind = np.dtype({"f2": "f2", "f1": "u1"}.get(dtype, "f4"))
        raw = None if data is None else np.ascontiguousarray(data, kind).reshape(-1).view(np.uint8)
        with self.making(f"a texture of {width} x {height}"):
            texture = self._owned(self.ctx.texture((width, height), channels, raw, dtype=dtype, alignment=1))
        texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        texture.repeat_x = texture.repeat_y = False
        return texture

    def buffer(self, data: NDArray[Any]) -> moderngl.Buffer:
        """A vertex buffer; the caller releases it."""
        with self.making(f"{data.nbytes / 1e6:.0f} MB of vertices"):
            return self._owned(self.ctx.buffer(np.ascontiguousarray(data).reshape(-1).view(np.uint8)))

    def framebuffer(
        self, textures: Sequence[moderngl.Texture], depth: moderngl.Texture | None = None,
    ) -> moderngl.Framebuffer:
        """A framebuffer on these colour textures; the caller releases it."""
        with self.making(f"a framebuffer of {textures[0].width} x {textures[0].height}"):
            return self._owned(self.ctx.framebuffer(list(textures), depth))

    @contextmanager
    def target(
        self, textures: Sequence[moderngl.Texture], depth: moderngl.Texture | None = None, *, clear: bool = False,
    ) -> Iterator[moderngl.Framebuffer]:
        """A framebuffer on these colour textures, for the block; ``clear``: the textures are zeroed first."""
        made = self.framebuffer(textures, depth)
        try:
            if clear:
                made.clear()
            yield made
        finally:
            made.release()

    @contextmanager
    def scope(self) -> Iterator[None]:
        """Frees at its end, however that comes, every texture, buffer and framebuffer that was made within.

        Scopes nest.  What is released earlier is released once.
        """
        owned: weakref.WeakSet[Any] = weakref.WeakSet()
        self._scopes.append(owned)
        try:
            yield
        finally:
            self._scopes.remove(owned)
            for thing in list(owned):
                thing.release()

    def _owned(self, made: Made) -> Made:
        if self._scopes:
            self._scopes[-1].add(made)
        return made

    def read(self, texture: moderngl.Texture, part: Rectangle | None = None) -> F32:
        """A float32 texture's content or a part of it, (h, w, channels)."""
        # Into an array of ours: moderngl's own read takes the process down where memory is short.
        width, height = texture.size if part is None else part[2:]
        values = np.empty((height, width, texture.components), np.float32)
        if part is None:
            texture.read_into(values, alignment=1)
        else:
            with self.target([texture]) as frame:
                frame.read_into(values, part, components=texture.components, dtype="f4", alignment=1)
        self.check("reading")
        self.check_alive()
        return values

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
        self, fragment: str, target: moderngl.Framebuffer, *, textures: Mapping[str, Textures],
        uniforms: Mapping[str, Any], defines: Mapping[str, str] | None = None,
        viewport: Rectangle | None = None, cells: DrawnCells | None = None,
    ) -> None:
        """Run ``shaders/<fragment>`` once for every pixel of the target, or of its viewport, or of ``cells`` of it."""
        vertex = "include/occupied_cells.vert" if cells else "include/screen.vert"
        program = self.programs.get(vertex, fragment, defines)
        key = fragment, program.glo, target.size
        whole = viewport or (0, 0, target.width, target.height)
        self.bind(program, textures)
        self.programs.set(program, uniforms)
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

    def kernel(
        self, name: str, target: moderngl.Framebuffer, *, textures: Mapping[str, Textures],
        uniforms: Mapping[str, Any], defines: Mapping[str, str], region: Rectangle,
    ) -> None:
        """Run the kernel ``shaders/<name>`` on a region (x, y, width, height) of the target's textures.

        As a compute shader where that is faster on this device (``prefers_compute``), else as a fragment shader.
        """
        for _ in self.steps(name, target, textures=textures, uniforms=uniforms, defines=defines, region=region):
            pass

    def steps(
        self, name: str, target: moderngl.Framebuffer, *, textures: Mapping[str, Textures],
        uniforms: Mapping[str, Any], defines: Mapping[str, str], region: Rectangle, work: F32 | None = None,
    ) -> Iterator[None]:
        """The same in pieces of about a slice, between which others may draw.

        ``work``: how much each row of the region asks for, in any unit that is the same for all calls of this kernel;
        None: its pixels.
        """
        outputs = target.color_attachments
        program = self._kernel_program(name, {**defines, "OUTPUTS": str(len(outputs))})
        key = name, program.glo, target.size
        for part, units in rectangles(region, lambda: self.budget.most(key), work):
            self.bind(program, textures)
            self.programs.set(program, uniforms)
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
        slower there); elsewhere the two are alike, and fragment shaders run everywhere.
        """
        if self.settings.kernels != "auto" or self.ctx.version_code < 430:
            return self.settings.kernels == "compute"
        if self.compute_faster is None:
            self.compute_faster = self._measure_compute()
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
            self.kernel("device/compute_probe.kernel", target, textures={}, uniforms={"u_steps": 64}, defines={},
                        region=(0, 0, size, size))
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
    def keeping_nearest(self) -> Iterator[None]:
        """Draws are hidden by what is nearer in the target's depth map."""
        self.ctx.enable(moderngl.DEPTH_TEST)
        try:
            yield
        finally:
            self.ctx.disable(moderngl.DEPTH_TEST)

    def collect(self) -> None:
        """Free what an error or a stop left behind, and switch off what it left on.

        moderngl's own ``gc`` stumbles over objects that were released before they were dropped.
        """
        while self.ctx.objects:
            left = self.ctx.objects.popleft()
            if hasattr(left, "release"):
                left.release()
        self.ctx.disable(moderngl.BLEND | moderngl.DEPTH_TEST)
        self.ctx.blend_equation = moderngl.FUNC_ADD  # type: ignore[assignment]  # the stub knows pairs alone

    def release(self) -> None:
        """Give the context back; nothing made by it may be used after."""
        self.ctx.release()
