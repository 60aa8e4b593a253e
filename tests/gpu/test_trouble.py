"""What a graphics device can do to a solve: run out of memory, go away, refuse a shader, not be there.

All of it happens for real, on Mesa; a reset of the driver is played by taking the context away from the thread: then
too calls do nothing, and reading back gives whatever lies there.
"""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import moderngl
import numpy as np
import pytest

from irpso_addon.core.data import Solution
from irpso_addon.core.errors import BadInput, DeviceError, DeviceLost, NoDevice, OutOfDeviceMemory, ShaderRefused
from irpso_addon.core.job import Progress
from irpso_addon.core.params import DeviceSettings, SolveSettings
from irpso_addon.gpu.device import programs, thread
from irpso_addon.gpu.device.context import Device
from irpso_addon.solve import pipeline
from tests.support import shoots
from tests.support import synthetic as syn

ROOT = Path(__file__).resolve().parents[2]
SETTINGS = SolveSettings(size=32, method="draft", model="one-lobe")
GL_BLEND, GL_DEPTH_TEST, GL_BLEND_EQUATION = 0x0BE2, 0x0B71, 0x8009
ONLY_MESA = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="EGL and limits of Linux")


@pytest.fixture(scope="module")
def shoot() -> syn.Shoot:
    return syn.shoot(syn.PATCHES, shoots.rig(1, 4), (40, 40))


def solve(shoot: syn.Shoot, **changed: Any) -> Solution:
    solution: Solution = thread.run(
        lambda: pipeline.solve(shoot.scene, replace(SETTINGS, **changed), shoot.read_image))
    return solution


def one_line(error: pytest.ExceptionInfo[BadInput]) -> str:
    said = str(error.value)
    assert "\n" not in said
    assert len(said) < 400
    return said


# ---- lost


def lose_context() -> None:
    """What a reset does, as far as a program can see."""
    egl = ctypes.CDLL("libEGL.so.1")
    egl.eglGetCurrentDisplay.restype = ctypes.c_void_p
    egl.eglMakeCurrent.argtypes = [ctypes.c_void_p] * 4
    assert egl.eglMakeCurrent(egl.eglGetCurrentDisplay(), None, None, None)


@ONLY_MESA
@pytest.mark.parametrize("stage", ["observe", "maps"])
def test_a_lost_context_is_noticed_and_the_next_solve_is_well(shoot, stage):
    before = solve(shoot)

    def job() -> Iterator[Progress]:
        steps, lost = pipeline.solve(shoot.scene, SETTINGS, shoot.read_image), False
        for step in steps:
            if step.stage == stage and not lost:
                lose_context()
                lost = True
            yield step

    with pytest.raises(DeviceLost, match=r"driver was reset.*solve again.*--device numpy") as caught:
        thread.run(job)
    one_line(caught)
    after = solve(shoot)
    for role in ("base_color", "roughness", "confidence"):
        assert getattr(before.maps, role).tobytes() == getattr(after.maps, role).tobytes()


@ONLY_MESA
def test_a_stage_that_fails_leaves_the_context_as_it_was(on_gl):
    """Draws that blend, or heed depth, and come to nothing; and whatever else a job left switched on."""
    def state(device: Device) -> tuple[int, ...]:
        gl = ctypes.CDLL("libGL.so.1")
        equation = ctypes.c_int()
        gl.glGetIntegerv(GL_BLEND_EQUATION, ctypes.byref(equation))
        return gl.glIsEnabled(GL_BLEND), gl.glIsEnabled(GL_DEPTH_TEST), equation.value

    def failing(device: Device, way: str) -> tuple[int, ...]:
        with pytest.raises(DeviceLost), getattr(device, way)():
            assert state(device) != clean
            raise DeviceLost("played")
        return state(device)

    clean = (0, 0, moderngl.FUNC_ADD)
    assert on_gl(state) == clean
    for way in ("adding", "keeping_least", "keeping_nearest"):
        assert on_gl(lambda device, way=way: failing(device, way)) == clean

    def untidy(device: Device) -> None:
        device.ctx.enable(moderngl.BLEND | moderngl.DEPTH_TEST)
        device.ctx.blend_equation = moderngl.MIN

    on_gl(untidy)
    assert on_gl(state) == clean


def test_a_probe_that_fails_decides_nothing(on_gl, monkeypatch):
    def job(device: Device) -> None:
        monkeypatch.setattr(device, "settings", replace(device.settings, kernels="auto"))
        monkeypatch.setattr(device, "compute_faster", None)
        monkeypatch.setattr(device, "is_software", False)  # which would measure nothing
        slices = []
        monkeypatch.setattr(device.budget, "choose", slices.append)

        def lost(*_: Any) -> float:
            raise DeviceLost("played")

        with monkeypatch.context() as patch:
            patch.setattr(Device, "_probe", lost)
            with pytest.raises(DeviceLost):
                assert device.prefers_compute is None
        assert device.compute_faster is None
        assert slices[-1] == device.settings.slice

    if on_gl(lambda device: device.ctx.version_code) < 430:
        pytest.skip("no compute shaders here: nothing is measured")
    on_gl(job)


def test_reading_and_looking_do_not_disturb_each_other(on_gl):
    """The canary sings beside whatever is read."""
    def job(device: Device) -> Any:
        texture = device.texture(5, 3, 2, np.arange(30, dtype=np.float32))
        for _ in range(3):
            device.check_alive()
        whole, part = device.read(texture), device.read(texture, (1, 1, 3, 2))
        texture.release()
        return whole, part

    whole, part = on_gl(job)
    assert (whole == np.arange(30, dtype=np.float32).reshape(3, 5, 2)).all()
    assert (part == whole[1:3, 1:4]).all()


# ---- memory


def test_a_texture_larger_than_the_device_takes(on_gl):
    with pytest.raises(OutOfDeviceMemory, match="per side"):
        on_gl(lambda device: device.texture(device.info["GL_MAX_TEXTURE_SIZE"] + 1, 1))


def test_a_texture_that_does_not_fit(on_gl):
    if "llvmpipe" not in on_gl(lambda device: device.name):
        pytest.skip("4 GB may fit here")
    with pytest.raises(OutOfDeviceMemory, match=r"no memory left for a texture of 16384 x 16384; .* Memory") as caught:
        on_gl(lambda device: device.texture(16384, 16384))
    one_line(caught)


def test_arrays_that_do_not_fit(on_gl):
    with pytest.raises(OutOfDeviceMemory, match=r"Unable to allocate .* lower Memory or Size"):
        on_gl(lambda device: np.empty((1 << 24, 1 << 24)))


LITTLE = """
import resource, sys
from irpso_addon.core.errors import OutOfDeviceMemory
from irpso_addon.core.params import SolveSettings
from irpso_addon.gpu.device import thread
from irpso_addon.solve import pipeline
from tests.support import shoots, synthetic as syn

def solve(size=32):
    settings = SolveSettings(size=size, method="draft", model="one-lobe")
    return thread.run(lambda: pipeline.solve(shoot.scene, settings, shoot.read_image))

shoot = syn.shoot(syn.PATCHES, shoots.rig(1, 4), (40, 40))
first = solve().maps.roughness.tobytes()
for more in (150, 400):  # MB beyond what is used already
    used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + (more << 20), resource.RLIM_INFINITY))
    try:
        solve(2048)
        print("solved")
    except OutOfDeviceMemory as error:
        print(error)
    resource.setrlimit(resource.RLIMIT_AS, (resource.RLIM_INFINITY,) * 2)
    assert solve().maps.roughness.tobytes() == first
print("alive")
"""


@ONLY_MESA
def test_a_process_with_little_memory_says_so_and_goes_on():
    """Wherever in a solve the memory ends."""
    done = subprocess.run([sys.executable, "-c", LITTLE], cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    *told, last = done.stdout.strip().splitlines()
    assert last == "alive"
    assert len(told) == 2
    assert all("lower Memory or Size" in line for line in told)


# ---- shaders


@pytest.fixture
def broken(on_gl, tmp_path, monkeypatch) -> Any:
    """broken(file, text): the add-on's shaders with ``text`` at the end of one, none of them compiled yet."""
    device: Device = on_gl(lambda device: device)

    def call(name: str, text: str) -> Device:
        shutil.copytree(programs.SHADERS, tmp_path / "shaders")
        with (tmp_path / "shaders" / name).open("a", encoding="utf-8") as file:
            file.write(text)
        monkeypatch.setattr(programs, "SHADERS", tmp_path / "shaders")
        monkeypatch.setattr(device, "programs", programs.Programs(device.ctx, device.check_alive))
        monkeypatch.setattr(device, "_quads", {})
        return device

    return call


def test_a_shader_that_does_not_compile(broken, shoot):
    device = broken("include/brdf.glsl", "nonsense here;\n")
    with pytest.raises(ShaderRefused, match=r"cannot compile it: include/brdf\.glsl:\d+.*syntax error") as caught:
        solve(shoot)
    said = one_line(caught)
    assert device.name in said
    assert said.startswith("shaders/")


NO_COMPUTE = "\n#ifdef COMPUTE\n#error not on this machine\n#endif\n"


def test_kernels_that_compute_shaders_cannot_do_run_as_fragment_shaders(broken, shoot, monkeypatch, on_gl):
    if on_gl(lambda device: device.ctx.version_code) < 430:
        pytest.skip("no compute shaders here")
    monkeypatch.setattr(on_gl(lambda device: device), "compute_faster", False)
    expected = solve(shoot)
    device = broken("solve/search.kernel", NO_COMPUTE)
    monkeypatch.setattr(device, "compute_faster", True)
    assert solve(shoot).maps.roughness.tobytes() == expected.maps.roughness.tobytes()
    assert device.prefers_compute is False
    monkeypatch.setattr(device, "settings", replace(device.settings, kernels="compute"))
    monkeypatch.setattr(thread, "_settings", DeviceSettings(kernels="compute"))
    monkeypatch.setattr(device, "compute_faster", True)
    with pytest.raises(ShaderRefused, match="not on this machine"):
        solve(shoot)


# ---- not there


@ONLY_MESA
@pytest.mark.parametrize(("environment", "said"), [
    ({"__EGL_VENDOR_LIBRARY_FILENAMES": "/nonexistent"}, "no context can be made"),
    ({"MESA_GL_VERSION_OVERRIDE": "3.2"}, "the driver's is older"),
])
def test_no_device_is_told_with_what_to_do(environment, said):
    code = ("from irpso_addon.core.errors import NoDevice\nfrom irpso_addon.gpu.device.context import Device\n"
            "try:\n    Device()\nexcept NoDevice as error:\n    print(error)")
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, env={**os.environ, **environment},
                          capture_output=True, text=True, timeout=60)
    (line,) = done.stdout.strip().splitlines()
    assert said in line
    assert "libgl1-mesa-dri" in line
    assert "--device numpy" in line


def test_every_device_error_is_handled_where_bad_input_is():
    for kind in (DeviceLost, NoDevice, OutOfDeviceMemory, ShaderRefused):
        assert issubclass(kind, DeviceError)
        assert issubclass(kind, BadInput)
