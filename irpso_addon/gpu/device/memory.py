"""An OpenGL context: whether it still works, and the textures, buffers and framebuffers in it.

Only the GL thread (gpu/device/thread.py) may create or use one: on Blender's main thread a standalone context lands
inside Blender's own, and the window goes black or crashes.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any, TypeVar

import moderngl
import numpy as np
from numpy.typing import NDArray

from ...core.data import F32
from ...core.errors import DeviceError, DeviceLost, NoDevice, OutOfDeviceMemory
from .context_check import ContextCheck
from .draw_budget import Rectangle
from .programs import SLOWER, Programs, first_line

BAD_MATCH = "0x3009"  # EGL's word for a version that is not there
SOFTWARE = ("llvmpipe", "softpipe")  # how the names of renderers without a GPU begin
Made = TypeVar("Made", moderngl.Texture, moderngl.Buffer, moderngl.Framebuffer, moderngl.VertexArray)


def newest_context() -> moderngl.Context:
    """A context of OpenGL 4.3 or later where there is one, for compute shaders; else of 3.3 or later.

    Mesa gives its newest version whatever it is asked for, but NVIDIA's EGL exactly that.  Raises plain Exception.
    """
    backend: dict[str, Any] = {"backend": "egl"} if sys.platform.startswith("linux") else {}
    if sys.platform != "darwin":  # macOS stops at 4.1
        with suppress(Exception):
            return moderngl.create_context(standalone=True, require=430, **backend)
    return moderngl.create_context(standalone=True, require=330, **backend)


class Scope:
    """Owns what is made within a block of `DeviceMemory.scope`."""

    def __init__(self, outer: Scope | None) -> None:
        self._outer = outer
        self._owned: dict[Any, None] = {}  # held: what the block drops is freed at its end too

    def own(self, made: Any) -> None:
        """Free it at the end."""
        self._owned[made] = None

    def disown(self, made: Any) -> bool:
        """Do not; whether it was owned."""
        there = made in self._owned
        self._owned.pop(made, None)
        return there

    def hand_over(self, *made: moderngl.Texture | moderngl.Buffer | None) -> None:
        """Leave these, the block's results, to the scope around it."""
        for each in made:
            if self.disown(each) and self._outer is not None:
                self._outer.own(each)

    def free(self) -> None:
        """At the end of the block, the last first."""
        for made in reversed(self._owned):
            made.release()


class DeviceMemory:
    """A moderngl context with its programs, and what is made in it.

    Whatever makes or reads textures raises OutOfDeviceMemory or DeviceLost when it is so.
    """

    def __init__(self) -> None:
        """Raises NoDevice."""
        try:
            self.ctx = newest_context()
        except Exception as error:  # moderngl raises plain Exception, with the platform's words
            why = "the driver's is older" if BAD_MATCH in str(error) else first_line(str(error))
            raise NoDevice(
                f"OpenGL 3.3: no context can be made ({why}); install a graphics driver (on Linux "
                f"also libegl1 and libgl1-mesa-dri, Mesa's software OpenGL), {SLOWER}"
            ) from None
        self.ctx.gc_mode = "context_gc"  # objects dropped on other threads wait for ours
        self.ctx.clear_errors()  # of what the context was asked while it was made
        self.info: dict[str, Any] = self.ctx.info
        self.name: str = self.info["GL_RENDERER"]
        self.is_software = self.name.startswith(SOFTWARE)  # draws on the processor
        self.lost = False  # whether it is of no more use
        self._context_check: ContextCheck | None = None
        self.programs = Programs(self.ctx, self.check_alive)
        self._scopes: list[Scope] = []
        self._context_check = ContextCheck(self.ctx)

    def describe(self) -> dict[str, Any]:
        """Renderer, vendor and version as the driver names them."""
        return {"renderer": self.name, "vendor": self.info["GL_VENDOR"], "version": self.info["GL_VERSION"]}

    def _finish(self) -> None:
        self.ctx.finish()
        self.check("drawing")

    def check_alive(self) -> None:
        """Raises DeviceLost where the context no longer works."""
        if self.lost or (self._context_check is not None and not self._context_check.passes()):
            self.lost = True
            raise DeviceLost(f"{self.name}: the graphics driver was reset, or gave up its context; solve again; lower "
                             f"GPU Batch if it happens again, {SLOWER}")

    def check(self, what: str) -> None:
        """Raises OutOfDeviceMemory if OpenGL has reported that; ``what`` was done.

        Other errors may be harmless: moderngl binds again what was bound before, even if it is deleted.
        """
        if self.ctx.error == "GL_OUT_OF_MEMORY":
            raise OutOfDeviceMemory(f"{self.name}: no memory left for {what}; lower Memory or Size, "
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
        """A texture read by texelFetch only; float32 unless ``dtype`` says another."""
        most = self.info["GL_MAX_TEXTURE_SIZE"]
        if max(width, height) > most:
            raise OutOfDeviceMemory(f"{self.name}: the picture has {width} x {height} pixels, but the limit is {most} "
                                    "per side; reduce it")
        kind = np.dtype({"f2": "f2", "f1": "u1", "u4": "u4"}.get(dtype, "f4"))
        raw = None if data is None else np.ascontiguousarray(data, kind).reshape(-1).view(np.uint8)
        with self.making(f"a texture of {width} x {height}"):
            texture = self._owned(self.ctx.texture((width, height), channels, raw, dtype=dtype, alignment=1))
        texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        texture.repeat_x = texture.repeat_y = False
        return texture

    def depth_map(self, width: int, height: int) -> moderngl.Texture:
        """Of a framebuffer."""
        with self.making(f"a depth map of {width} x {height}"):
            return self._owned(self.ctx.depth_texture((width, height)))

    def buffer(self, data: NDArray[Any]) -> moderngl.Buffer:
        """A vertex buffer; belongs to the scope, or else to the caller."""
        with self.making(f"{data.nbytes / 1e6:.0f} MB of vertices"):
            return self._owned(self.ctx.buffer(np.ascontiguousarray(data).reshape(-1).view(np.uint8)))

    def vertex_array(
        self, program: moderngl.Program, content: list[tuple[Any, ...]],
    ) -> moderngl.VertexArray:
        """Buffers as a program reads them, see moderngl; belongs to the scope, or else to the caller."""
        return self._owned(self.ctx.vertex_array(program, content))

    def framebuffer(
        self, textures: Sequence[moderngl.Texture], depth: moderngl.Texture | None = None,
    ) -> moderngl.Framebuffer:
        """A framebuffer on these colour textures; belongs to the scope, or else to the caller."""
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
            if self._scopes:
                self._scopes[-1].disown(made)

    @contextmanager
    def scope(self) -> Iterator[Scope]:
        """Frees at its end, however that comes, every texture, buffer and framebuffer that was made within.

        Scopes nest.  What is released earlier is released once.
        """
        scope = Scope(self._scopes[-1] if self._scopes else None)
        self._scopes.append(scope)
        try:
            yield scope
        finally:
            self._scopes.remove(scope)
            scope.free()

    def _owned(self, made: Made) -> Made:
        if self._scopes:
            self._scopes[-1].own(made)
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

    def collect(self) -> None:
        """Free what an error or a stop left behind, and switch off what it left on.

        moderngl's own ``gc`` stumbles over objects that were released before they were dropped.
        """
        while self.ctx.objects:
            left = self.ctx.objects.popleft()
            if hasattr(left, "release"):
                left.release()
        self.ctx.disable(moderngl.BLEND | moderngl.DEPTH_TEST | moderngl.CULL_FACE)
        self.ctx.blend_equation = moderngl.FUNC_ADD  # type: ignore[assignment]  # the stub knows pairs alone

    def release(self) -> None:
        """Give the context back; nothing made by it may be used after."""
        self.ctx.release()
