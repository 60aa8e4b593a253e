"""The assembler as text, the compiler's errors by file and line, and uniforms by name."""

from __future__ import annotations

import re
from pathlib import Path

import moderngl
import numpy as np
import pytest

from irpso_addon.core.errors import ShaderRefused
from irpso_addon.gpu.device import programs
from irpso_addon.gpu.device.context import Device, Inputs

SCREEN = "void main() { gl_Position = vec4(gl_VertexID == 1 ? 3 : -1, gl_VertexID == 2 ? 3 : -1, 0, 1); }\n"
MAIN = "out vec4 o;\nvoid main() { o = vec4(value()); }\n"


@pytest.fixture
def shaders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of shaders of our own."""
    monkeypatch.setattr(programs, "SHADERS", tmp_path)
    (tmp_path / "include").mkdir()
    (tmp_path / "screen.vert").write_text(SCREEN)
    return tmp_path


def body(source: str) -> list[str]:
    """The lines of an assembled source that came from files."""
    return [line for line in source.splitlines() if line and not line.startswith("#")]


def test_include_nests_and_pastes_once(shaders):
    (shaders / "include/base.glsl").write_text("float base() { return 1.0; }\n")
    (shaders / "include/left.glsl").write_text('#include "include/base.glsl"\nfloat left() { return base(); }\n')
    (shaders / "include/right.glsl").write_text('  #include "include/base.glsl"\nfloat right() { return base(); }\n')
    (shaders / "main.frag").write_text(
        '#include "include/left.glsl"\n#include "include/right.glsl"\n#include "include/base.glsl"\nvoid main() {}\n')
    source = programs.assemble("main.frag")
    assert body(source) == [
        "float base() { return 1.0; }", "float left() { return base(); }", "float right() { return base(); }",
        "void main() {}"]
    assert "#include" not in source


def test_version_comes_first_then_the_defines(shaders):
    (shaders / "main.frag").write_text("void main() {}\n")
    lines = programs.assemble("main.frag", {"LAYERS": "7", "LIGHTS": "2"}).splitlines()
    assert lines[:3] == [programs.VERSION, "#define LAYERS 7", "#define LIGHTS 2"]


@pytest.mark.parametrize("chain", [["main.frag"], ["include/a.glsl", "main.frag"],
                                   ["include/a.glsl", "include/b.glsl", "include/a.glsl"]])
def test_a_circular_include_is_an_error(shaders, chain):
    for name, target in zip(["main.frag", *chain], chain, strict=False):
        (shaders / name).write_text(f'#include "{target}"\n')
    with pytest.raises(ValueError, match=re.escape(f"shaders/{chain[-1]} includes itself")):
        programs.assemble("main.frag")


def test_a_missing_file_is_an_error(shaders):
    (shaders / "main.frag").write_text('#include "include/absent.glsl"\n')
    with pytest.raises(FileNotFoundError, match="absent"):
        programs.assemble("main.frag")


@pytest.mark.parametrize(("wrong", "said"), [("nonsense;", "nonsense"), ("int i = 1.5;", "float"), ("1 +;", "syntax")])
@pytest.mark.parametrize(("broken", "where"), [
    ("include/base.glsl", "include/base.glsl:3"), ("include/left.glsl", "include/left.glsl:4"),
    ("main.frag", "main.frag:5"),
])
def test_a_broken_shader_names_its_file_and_line(ctx, shaders, broken, where, wrong, said):
    """Drivers differ in what they keep of #line for which error: all three kinds must come out right."""
    texts = {
        "include/base.glsl": ["// base", "", "float base() { return 1.0; }"],
        "include/left.glsl": ["// left", '#include "include/base.glsl"', "", "float value() { return base(); }"],
        "main.frag": ['#include "include/left.glsl"', '#include "include/base.glsl"', "out vec4 o;", "",
                      "void main() { o = vec4(value()); }"],
    }
    texts[broken][-1] = texts[broken][-1].replace("{", f"{{ {wrong}")
    for name, lines in texts.items():
        (shaders / name).write_text("\n".join(lines) + "\n")
    with pytest.raises(ShaderRefused, match=rf"{re.escape(where)}\b[^\n]*{said}") as caught:
        programs.Programs(ctx).get("screen.vert", "main.frag")
    assert caught.value.__suppress_context__  # one message, not two tracebacks


def test_a_broken_vertex_shader_names_its_own_file(ctx, shaders):
    (shaders / "broken.vert").write_text("// first\nvoid main() { nonsense; }\n")
    (shaders / "main.frag").write_text("float value() { return 1.0; }\n" + MAIN)
    with pytest.raises(ShaderRefused, match=r"broken\.vert:2\b[\s\S]*nonsense"):
        programs.Programs(ctx).get("broken.vert", "main.frag")


@pytest.fixture
def program(ctx, shaders) -> tuple[programs.Programs, moderngl.Program]:
    (shaders / "main.frag").write_text(
        "uniform float u_used;\nuniform float u_dropped;\nuniform int u_list[3];\n"
        "float value() { return u_used + float(u_list[2]); }\n" + MAIN)
    made = programs.Programs(ctx)
    return made, made.get("screen.vert", "main.frag")


def test_a_uniform_is_set_and_a_dropped_one_ignored(program):
    made, built = program
    assert "u_dropped" not in built  # else the test says nothing
    made.set(built, {"u_used": 2.5, "u_dropped": 1.0, "u_list": (4, 5, 6)})
    assert built["u_used"].value == 2.5
    assert tuple(built["u_list"].value) == (4, 5, 6)


def test_an_undeclared_uniform_is_an_error(program):
    made, built = program
    with pytest.raises(KeyError, match="u_mistyped"):
        made.set(built, {"u_mistyped": 1.0})


def test_a_program_is_built_once_for_the_same_defines(ctx, shaders):
    (shaders / "main.frag").write_text("float value() { return float(N); }\n" + MAIN)
    made = programs.Programs(ctx)
    first = made.get("screen.vert", "main.frag", {"N": "1"})
    assert made.get("screen.vert", "main.frag", {"N": "1"}) is first
    assert made.get("screen.vert", "main.frag", {"N": "2"}) is not first


def test_programs_of_earlier_jobs_are_given_back(on_gl, monkeypatch):
    """Only the last used stay, however many jobs there are; what was given back is made again and draws the same."""
    monkeypatch.setattr(programs, "KEPT", 3)
    held = on_gl(lambda device: device.texture(1, 1, 4, np.array([1.0, 2, 3, 4], np.float32)))

    def drawn(number: int) -> tuple[moderngl.Program, list[float]]:
        def job(device: Device) -> tuple[moderngl.Program, list[float]]:
            defines = {"JOB": str(number)}
            with device.scope():
                texture = device.texture(1, 1)
                with device.target([texture]) as target:
                    device.draw("device/context_check.frag", target, Inputs(
                        {"u_kept": held}, {"u_number": float(number)}, defines))
                return (next(reversed(device.programs._built.values())), device.read(texture).ravel().tolist())

        return on_gl(job)  # type: ignore[no-any-return]

    made = []
    for number in (*range(1, 9), 1, 7, 2):
        program, pixel = drawn(number)
        made.append(program)
        assert pixel == [number, 2 * number, 3 * number, 4 * number]
    alive = [number for number, program in enumerate(made) if not isinstance(program.mglo, moderngl.InvalidObject)]
    assert alive == [6, 7, 8, 9, 10] and made[9] is made[6]  # of 7, 8, 1, 7 and 2: the last three, and the new one


def test_every_shader_of_the_add_on_assembles():
    names = [p.relative_to(programs.SHADERS).as_posix() for p in sorted(programs.SHADERS.rglob("*.*"))
             if p.suffix != ".md"]
    assert len(names) > 20
    for name in names:
        source = programs.assemble(name)
        assert source.count("uniform sampler2D u_principled_table;") <= 1
