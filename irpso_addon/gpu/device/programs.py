"""GLSL from shaders/: include-once assembly, compilation with readable errors, uniforms by name.

``#include "include/brdf.glsl"`` pastes a file of shaders/ once per program, whatever the nesting
(moderngl's own includes neither nest nor guard).  ``#line`` keeps the compiler's line numbers true;
the file is coded into the line number, because drivers keep the source number for some errors only.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import moderngl

from ...core.errors import ShaderRefused
from ...core.lens import LEAST_SCALE
from ...core.models import NUMBERS_OF_TWO
from ...core.shading import brdf, environment, lights, tables

SHADERS = Path(__file__).resolve().parents[3] / "shaders"
VERSION = "#version 330 core"  # the oldest that every Blender machine has; macOS stops at 4.1
COMPUTE_VERSION = "#version 430 core"
WORKGROUP = 8  # texels along a side of what a compute shader's group does
UNLIT_BELOW = -100.0  # radiance over irradiance: a channel without light is marked by -1000; noise is a little below 0
SEAM = 0.1  # of a pixel's coverage, for each of its corners that lies on another UV island
# Numbers that Python and shaders both know: every program gets them as defines, no shader spells them.
SHARED_CONSTANTS: Mapping[str, float | int] = {
    "WORKGROUP": WORKGROUP,
    "ROUGHNESS_MIN": brdf.ROUGHNESS_MIN, "ROUGHNESS_RANGE": 1 / brdf.ROUGHNESS_MIN,
    "LEVEL_F0": 2 * tables.F0, "LEVEL_MIN": brdf.LEVEL_MIN,
    "ALPHA2_MIN": brdf.ALPHA2_MIN, "COS2H_MIN": brdf.COS2H_MIN, "ROUGH_LOST": brdf.ROUGH_LOST,
    "LEAST_SCALE": LEAST_SCALE, "SEAM": SEAM, "UNLIT_BELOW": UNLIT_BELOW, "NUMBERS_OF_TWO": float(NUMBERS_OF_TWO),
    "TABLE_SIZE": tables.SIZE, "LOBE_NODES": tables.LOBE_NODES,
    "FRESNEL_NODES": tables.FRESNEL_NODES, "FRESNEL_SLICES": tables.SLICES,
    **{f"LIGHT_{kind}": number for number, kind in enumerate(lights.KINDS)},
    "ENVIRONMENT_NODES": environment.NODES, "ENVIRONMENT_COLUMNS": environment.NODE_COLUMNS,
    "ENVIRONMENT_LEAST": environment.LEAST,
    "LIGHT_ELLIPSE_SIDES": lights.ELLIPSE_SIDES, "LIGHT_POINT_SIZE": lights.POINT_SIZE,
    "LIGHT_QUADRATURE": lights.QUADRATURE, "GOLDEN_RATIO": lights.GOLDEN_RATIO,
}
SLOWER = "or choose device numpy (--device numpy), which is slow and makes small maps"
KEPT = 96  # compiled programs that stay from job to job: a solve uses 35 to 65, each of about 5 MB in software OpenGL
_INCLUDE = re.compile(r'^\s*#include\s+"([^"]+)"\s*$')
_FILE = 1_000_000  # line numbers from here on: file number times this, plus the line
_UNIFORM = re.compile(r"^\s*(?:layout\([^)]*\)\s*)?(?:writeonly\s+)?uniform\s+\w+\s+(\w+)", re.MULTILINE)


def assemble(name: str, defines: Mapping[str, str] | None = None) -> str:
    """The full source of ``shaders/<name>``: version, defines, SHARED_CONSTANTS, every include pasted once.

    Raises FileNotFoundError for a missing file, ValueError for a circular include.
    """
    return _assemble(name, defines)[0]


def _assemble(name: str, defines: Mapping[str, str] | None, version: str = VERSION) -> tuple[str, list[str]]:
    files: list[str] = []
    head = [version, *(f"#define {k} {v}" for k, v in {**(defines or {}), **SHARED_CONSTANTS}.items())]
    return "\n".join([*head, *_paste(name, files, ())]) + "\n", files


def _paste(name: str, files: list[str], open_files: tuple[str, ...]) -> list[str]:
    if name in open_files:
        raise ValueError(f"shaders/{name} includes itself through {' -> '.join(open_files)}")
    files.append(name)
    number = len(files) - 1
    lines = [f"#line {_FILE * (number + 1) + 1}"]
    for row, line in enumerate((SHADERS / name).read_text(encoding="utf-8").splitlines(), start=1):
        include = _INCLUDE.match(line)
        if not include:
            lines.append(line)
        elif include.group(1) not in files or include.group(1) in (*open_files, name):
            lines += [*_paste(include.group(1), files, (*open_files, name)), f"#line {_FILE * (number + 1) + row + 1}"]
        else:
            lines.append("")
    return lines


def readable(message: str, files: list[str]) -> str:
    """The compiler's message with coded line numbers turned into names: ``include/brdf.glsl:7``."""

    def named(m: re.Match[str]) -> str:
        number, line = divmod(int(m.group(1)), _FILE)
        return f"{files[number - 1]}:{line}" if 1 <= number <= len(files) else m.group(0)

    return re.sub(r"\b(?:0:)?(\d{7,})\b", named, message)


def first_line(message: str) -> str:
    """The line of a driver's message that tells most: its first error, else its first words."""
    lines = [line.strip() for line in message.splitlines() if line.strip()] or ["no reason given"]
    return next((line for line in lines if "error" in line.lower()), lines[0])


class Programs:
    """The compiled programs of one context, each built once, while it is not given back."""

    def __init__(self, ctx: moderngl.Context, check_alive: Callable[[], None] = lambda: None) -> None:
        """``check_alive`` raises where the context is lost: then no shader is to blame."""
        self._ctx, self._check_alive = ctx, check_alive
        self._built: dict[tuple[Any, ...], moderngl.Program] = {}  # here and below: the one used last comes last
        self._kernels: dict[tuple[Any, ...], moderngl.ComputeShader] = {}
        self._declared: dict[int, set[str]] = {}

    def get(self, vertex: str, fragment: str, defines: Mapping[str, str] | None = None) -> moderngl.Program:
        """The program of ``shaders/<vertex>`` and ``shaders/<fragment>``; raises ShaderRefused with file:line."""
        key = (vertex, fragment, *sorted((defines or {}).items()))
        if key not in self._built:
            source_v, files_v = _assemble(vertex, defines)
            source_f, files_f = _assemble(fragment, defines)
            try:
                program = self._ctx.program(vertex_shader=source_v, fragment_shader=source_f)
            except moderngl.Error as error:
                text = str(error)
                files = files_f if "fragment_shader" in text else files_v
                raise self._refused(fragment, text, files) from None
            self._built[key] = program
            self._declared[program.glo] = set(_UNIFORM.findall(source_v) + _UNIFORM.findall(source_f))
        else:
            self._built[key] = self._built.pop(key)
        return self._built[key]

    def compute(self, name: str, defines: Mapping[str, str]) -> moderngl.ComputeShader:
        """``shaders/<name>``, a kernel (include/kernel.glsl), as a compute shader.

        Raises ShaderRefused with file:line.
        """
        key = (name, *sorted(defines.items()))
        if key not in self._kernels:
            source, files = _assemble(name, {**defines, "COMPUTE": "1"}, COMPUTE_VERSION)
            try:
                kernel = self._ctx.compute_shader(source)
            except moderngl.Error as error:
                raise self._refused(name, str(error), files) from None
            self._kernels[key] = kernel
            self._declared[kernel.glo] = set(_UNIFORM.findall(source))
        else:
            self._kernels[key] = self._kernels.pop(key)
        return self._kernels[key]

    def give_back(self) -> set[int]:
        """Free the programs that were not used for longest, until KEPT of each kind stay; OpenGL's names of the freed.

        Each number of views or cameras makes programs of its own: captures of many kinds would fill the memory.
        """
        oldest: list[moderngl.Program | moderngl.ComputeShader] = [
            *(self._built.pop(key) for key in tuple(self._built)[:max(len(self._built) - KEPT, 0)]),
            *(self._kernels.pop(key) for key in tuple(self._kernels)[:max(len(self._kernels) - KEPT, 0)])]
        names = {program.glo for program in oldest}
        for program in oldest:
            del self._declared[program.glo]
            program.release()
        return names

    def _refused(self, name: str, message: str, files: list[str]) -> ShaderRefused:
        self._check_alive()
        return ShaderRefused(f"shaders/{name}: {self._ctx.info['GL_RENDERER']} cannot compile it: "
                             f"{first_line(readable(message, files))}; update the graphics driver, {SLOWER}")

    def set(self, program: moderngl.Program | moderngl.ComputeShader, values: Mapping[str, Any]) -> None:
        """Set uniforms.  One that the compiler dropped is skipped; one never declared raises KeyError."""
        for name, value in values.items():
            if name in program:
                member = program[name]
                if isinstance(member, moderngl.Uniform):
                    if isinstance(value, bytes):
                        member.write(value)
                    else:
                        member.value = value
            elif name.split("[")[0] not in self._declared[program.glo]:
                raise KeyError(f"no shader of this program declares the uniform '{name}'")
