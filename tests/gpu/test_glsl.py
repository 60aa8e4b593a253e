"""What Mesa forgives: every program of this run through glslang, and within the limits of the least OpenGL.

These tests run last (conftest.py): in a run of the whole folder they see every program of the library.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from irpso_addon.gpu.device import programs
from irpso_addon.gpu.device.context import Device
from tests.gpu.glsl import Made, Recorder

UNITS = 16  # GL_MAX_TEXTURE_IMAGE_UNITS at least, and on a Mac; llvmpipe has 32
OUTPUTS = 8  # GL_MAX_DRAW_BUFFERS, and GL_MAX_IMAGE_UNITS of OpenGL 4.3
# What blender/viewer/view_draw.py declares of them; Blender writes these lines itself.
PLATE = {
    "plate.vert": "in vec2 position;\nin vec2 place;\nout vec2 uv;\nuniform mat4 mvp;\n",
    "plate.frag": "in vec2 uv;\nout vec4 color;\nuniform int kind;\nuniform float wipe, gain, top, least;\n"
                  "uniform sampler2D first;\nuniform sampler2D second;\n",
}


def test_glslang_has_nothing_to_say(recorder: Recorder, solved: object, tmp_path: Path) -> None:
    plate = [programs.VERSION + "\n" + head + (programs.SHADERS / "display" / name).read_text(encoding="utf-8")
             for name, head in PLATE.items()]
    recorder.made.add(Made((("vert", plate[0]), ("frag", plate[1]))))
    assert len(recorder.made) > 20
    said = recorder.complaints(tmp_path)
    assert not said, said


def test_every_shader_was_among_them(recorder: Recorder, request: pytest.FixtureRequest, on_gl) -> None:
    """A folder's run that leaves one out would say nothing of it."""
    here = Path(__file__).parent
    if {item.path.name for item in request.session.items} != {path.name for path in here.glob("test_*.py")}:
        pytest.skip("only where all of tests/gpu runs")
    seen = {file for made in recorder.made for _, text in made.stages for file in recorder.files.get(text, [])}
    missing = {path.relative_to(programs.SHADERS).as_posix() for path in programs.SHADERS.rglob("*.*")
               if path.suffix != ".md"} - seen
    if on_gl(lambda device: device.ctx.version_code) < 430:
        missing -= {"device/compute_probe.kernel"}  # measures whether compute shaders are faster
    assert {name for name in missing if not name.startswith("display/")} == set()


def test_no_program_needs_more_than_a_mac_has(recorder: Recorder, solved: object) -> None:
    for made in recorder.made:
        endings = [ending for ending, _ in made.stages]
        assert made.units <= UNITS, endings
        for _, text in made.stages:
            outputs = [line for line in text.splitlines() if line.startswith("#define OUTPUTS ")]
            assert all(int(line.split()[-1]) <= OUTPUTS for line in outputs)


def test_complaints_name_file_and_line(recorder: Recorder, tmp_path: Path) -> None:
    """The test above can fail: one thing that Mesa takes, and stages that do not fit, which nobody may take."""
    own = Recorder()
    name = "include/screen.vert"
    source, files = programs._assemble(name, None)
    broken = source.replace("void main", "uniform sampler2D many[3];\nuniform int which;\n"
                            "vec4 any() { return texelFetch(many[which], ivec2(0), 0); }\nvoid main", 1)
    own.files[broken] = files
    head = programs.VERSION + "\n"
    own.made = {Made((("vert", broken),)),
                Made((("vert", head + "out float kept;\nvoid main() { kept = 1.0; }\n"),
                      ("frag", head + "flat in int kept;\nout vec4 o;\nvoid main() { o = vec4(kept); }\n")))}
    said = own.complaints(tmp_path)
    assert f"{name}:" in said
    assert "variable indexing sampler array" in said
    assert "Types must match" in said


@pytest.mark.skipif("MESA_GL_VERSION_OVERRIDE" not in os.environ, reason="the driver's own version")
def test_the_override_holds(on_gl) -> None:
    """What .ci/run asks of one of its two runs: OpenGL 4.1 core, as a Mac has it; so without compute shaders."""
    assert os.environ["MESA_GL_VERSION_OVERRIDE"] == "4.1"

    def job(device: Device) -> tuple[int, str, bool, int]:
        version = device.ctx.info["GL_VERSION"]
        return device.ctx.version_code, version, device.prefers_compute, len(device.programs._kernels)

    code, version, compute, kernels = on_gl(job)
    assert code == 410
    assert "4.1" in version
    assert "Core" in version
    assert (compute, kernels) == (False, 0)
