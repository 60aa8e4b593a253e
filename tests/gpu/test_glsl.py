"""What Mesa forgives: programs through glslang, and within the limits of the least OpenGL; and that faults are found.

Every program of a run is looked at when it ends (``recorder`` in conftest.py); of the whole folder's run also whether
some shader was in none.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from irpso_addon.gpu.device import programs
from irpso_addon.gpu.device.context import Device
from tests.gpu.glsl import UNITS, Made, Recorder

# What blender/viewer/view_draw.py declares of them; Blender writes these lines itself.
PLATE = {
    "plate.vert": "in vec2 position;\nin vec2 place;\nout vec2 uv;\nuniform mat4 mvp;\n",
    "plate.frag": "in vec2 uv;\nout vec4 color;\nuniform int kind;\nuniform float wipe, gain, top, least;\n"
                  "uniform sampler2D first;\nuniform sampler2D second;\n",
}


def test_the_window_s_programs_and_those_of_a_solve(recorder: Recorder, solved: object, tmp_path: Path) -> None:
    """Those of every other test too, at the end of the run (conftest.py)."""
    plate = [programs.VERSION + "\n" + head + (programs.SHADERS / "display" / name).read_text(encoding="utf-8")
             for name, head in PLATE.items()]
    recorder.made.add(Made((("vert", plate[0]), ("frag", plate[1]))))
    assert len(recorder.made) > 20
    assert recorder.faults(tmp_path) == []


def test_what_needs_more_than_a_mac_has_is_told(tmp_path: Path) -> None:
    own, head = Recorder(), programs.VERSION + "\n"
    text = head + "#define OUTPUTS 9\nout vec4 o;\nvoid main() { o = vec4(1.0); }\n"
    own.files[text] = ["here.frag"]
    own.made = {Made((("frag", text),), UNITS + 1)}
    assert own.faults(tmp_path) == [
        "['here.frag']: 17 textures, 16 are sure", "['here.frag']: #define OUTPUTS 9, 8 are sure"]


def test_a_shader_that_no_program_has_is_told() -> None:
    own = Recorder()
    every = set(own.unused(410))
    assert "include/brdf.glsl" in every and "device/compute_probe.kernel" not in every
    assert set(own.unused(430)) == every | {"device/compute_probe.kernel"}
    source, files = programs._assemble("include/screen.vert", None)
    own.files[source] = files
    own.made = {Made((("vert", source),))}
    assert every - set(own.unused(410)) == set(files) & every != set()


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
