"""The one OpenGL context of the process, and the small things every stage needs from it.

Only the GL thread (gpu/thread.py) may create or use a Device: on Blender's main thread a
standalone context lands inside Blender's own, and the window goes black or crashes.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cached_property
from typing import Any

import moderngl
import numpy as np

from ..core.data import F32
from ..core.errors import BadInput
from ..core.params import DeviceSettings
from .cells import Cells
from .programs import Programs

COMPUTE_GAIN = 1.5  # how many times faster compute shaders must be to be taken
Textures = moderngl.Texture | tuple[moderngl.Texture, ...] | None


class Device:
    """A moderngl context with its programs and a full-screen triangle."""

    def __init__(self) -> None:
        try:
            backend: dict[str, Any] = {"backend": "egl"} if sys.platform.startswith("linux") else {}
            self.ctx = moderngl.create_context(standalone=True, require=330, **backend)
        except Exception as error:  # moderngl raises plain Exception, with the platform's words
            raise BadInput(
                f"OpenGL 3.3: no context can be made ({str(error).strip()}); install a graphics driver "
                "(on Linux also libegl1 and libgl1-mesa-dri)"
            ) from None
        self.settings = DeviceSettings()
        self.ctx.gc_mode = "context_gc"  # objects dropped on other threads wait for ours
        self.programs = Programs(self.ctx)
        self._quads: dict[int, moderngl.VertexArray] = {}

    def configure(self, settings: DeviceSettings) -> None:
        """How the device is used from now on.  Raises BadInput where it cannot do that."""
        if settings.kernels == "compute" and self.ctx.version_code < 430:
            raise BadInput(f"kernels compute: {self.ctx.info['GL_RENDERER']} has OpenGL {self.ctx.version_code / 100}, "
                           "compute shaders need 4.3; choose auto or fragment")
        if settings.kernels != self.settings.kernels:
            self.__dict__.pop("prefers_compute", None)
        self.settings = settings

    def describe(self) -> dict[str, Any]:
        """Renderer, vendor and version as the driver names them."""
        info = self.ctx.info
        return {"renderer": info["GL_RENDERER"], "vendor": info["GL_VENDOR"], "version": info["GL_VERSION"]}

    def texture(
        self, width: int, height: int, channels: int = 4, data: F32 | None = None, dtype: str = "f4"
    ) -> moderngl.Texture:
        """A texture read by texelFetch only; float32 unless told."""
        raw = None if data is None else np.ascontiguousarray(data, np.dtype({"f2": "f2", "f1": "u1"}.get(dtype, "f4")))
        texture = self.ctx.texture((width, height), channels, raw.tobytes() if raw is not None else None,
                                   dtype=dtype, alignment=1)
        texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        texture.repeat_x = texture.repeat_y = False
        return texture

    def read(self, texture: moderngl.Texture) -> F32:
        """A float32 texture's content, (h, w, channels)."""
        raw = np.frombuffer(texture.read(alignment=1), np.float32)
        return raw.reshape(texture.height, texture.width, texture.components)

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
        viewport: tuple[int, int, int, int] | None = None, cells: Cells | None = None,
    ) -> None:
        """Run ``shaders/<fragment>`` once for every pixel of the target, or of its viewport, or of ``cells`` of it."""
        program = self.programs.get("include/cells.vert" if cells else "include/screen.vert", fragment, defines)
        self.bind(program, textures)
        self.programs.set(program, uniforms)
        target.use()
        self.ctx.viewport = viewport or (0, 0, target.width, target.height)
        if cells:
            self.programs.set(program, cells.uniforms)
            cells.render(program)
            return
        if program.glo not in self._quads:
            self._quads[program.glo] = self.ctx.vertex_array(program, [])
        self._quads[program.glo].render(moderngl.TRIANGLES, vertices=3)

    def kernel(
        self, name: str, target: moderngl.Framebuffer, *, textures: Mapping[str, Textures],
        uniforms: Mapping[str, Any], defines: Mapping[str, str], region: tuple[int, int, int, int],
    ) -> None:
        """Run the kernel ``shaders/<name>`` on a region (x, y, width, height) of the target's textures.

        As a compute shader where that is faster on this device (``prefers_compute``), else as a fragment shader.
        """
        outputs = target.color_attachments
        defines = {**defines, "OUTPUTS": str(len(outputs))}
        if not self.prefers_compute:
            self.draw(name, target, textures=textures, uniforms=uniforms, defines=defines, viewport=region)
            return
        program = self.programs.compute(name, defines)
        self.bind(program, textures)
        self.programs.set(program, {**uniforms, "u_region": region})
        for unit, texture in enumerate(outputs):
            assert isinstance(texture, moderngl.Texture)
            texture.bind_to_image(unit, read=False, write=True)
        program.run(-(-region[2] // 8), -(-region[3] // 8))
        self.ctx.memory_barrier()

    @cached_property
    def prefers_compute(self) -> bool:
        """Whether kernels run as compute shaders: as the settings say, or where that is clearly faster.

        Measured once, by the same arithmetic both ways.  Data-centre GPUs have few graphics units (30 times
        slower there); elsewhere the two are alike, and fragment shaders run everywhere.
        """
        if self.settings.kernels != "auto" or self.ctx.version_code < 430:
            return self.settings.kernels == "compute"
        size = 512
        target = self.framebuffer([self.texture(size, size)])
        seconds = []
        for compute in (False, True):
            self.__dict__["prefers_compute"] = compute
            taken = []
            for _ in range(4):  # the first compiles and warms up
                start = time.perf_counter()
                self.kernel("include/probe.glsl", target, textures={}, uniforms={"u_steps": 64}, defines={},
                            region=(0, 0, size, size))
                self.ctx.finish()
                taken.append(time.perf_counter() - start)
            seconds.append(min(taken[1:]))
        target.color_attachments[0].release()
        target.release()
        return seconds[1] * COMPUTE_GAIN < seconds[0]

    @contextmanager
    def adding(self) -> Iterator[None]:
        """Draws add to what the target holds."""
        self.ctx.enable(moderngl.BLEND)
        self.ctx.blend_func = (moderngl.ONE, moderngl.ONE)
        self.ctx.blend_equation = moderngl.FUNC_ADD  # type: ignore[assignment]  # the stub knows pairs alone
        try:
            yield
        finally:
            self.ctx.disable(moderngl.BLEND)

    def framebuffer(self, textures: Sequence[moderngl.Texture]) -> moderngl.Framebuffer:
        """A framebuffer on these colour textures; the caller releases it."""
        return self.ctx.framebuffer(list(textures))

    def collect(self) -> None:
        """Free what an error or a stop left behind.

        moderngl's own ``gc`` stumbles over objects that were released before they were dropped.
        """
        while self.ctx.objects:
            left = self.ctx.objects.popleft()
            if hasattr(left, "release"):
                left.release()

    def release(self) -> None:
        """Give the context back; nothing made by it may be used after."""
        self.ctx.release()
