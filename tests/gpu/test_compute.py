"""Kernels as compute shaders: the same maps as fragment shaders make, chosen by measurement, and done without."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from irpso_addon.core.errors import BadInput
from irpso_addon.core.params import DeviceSettings, SolveSettings
from irpso_addon.gpu.device import thread
from irpso_addon.gpu.device.context import Device, Inputs
from irpso_addon.gpu.solve.paper_swarm import PaperSwarm
from irpso_addon.gpu.solve.solver import Solver
from tests.support.texels import Texels, exact, finish

ROOT = Path(__file__).resolve().parents[2]
SIZE = 32


@pytest.fixture
def both(on_gl: Any, monkeypatch: pytest.MonkeyPatch) -> Any:
    """both(job) -> what job(device) gives as fragment shaders, and as compute shaders."""
    device = on_gl(lambda device: device)
    if on_gl(lambda device: device.ctx.version_code) < 430:
        pytest.skip("no compute shaders here")

    def call(job: Any) -> list[list[np.ndarray]]:
        made = []
        for compute in (False, True):
            monkeypatch.setattr(device, "compute_faster", compute)
            kernels = on_gl(lambda device: len(device.programs._kernels))
            made.append(on_gl(job))
            built = on_gl(lambda device: len(device.programs._kernels)) - kernels
            assert compute or not built  # else it would compare a path with itself
        return made

    return call


def run(texels: Texels, lobes: int, method: str, **chosen: Any) -> Any:
    """A job: every map of a solve; tiles and bands end within the 8 x 8 texels of a work group."""

    def job(device: Device) -> list[np.ndarray]:
        source = texels.source(device)
        solver = Solver(device, source, SolveSettings(size=SIZE, method=method, **chosen), (20, 13))
        maps = finish(solver.solve_two() if lobes == 2 else solver.solve())
        found = maps.roughness if maps.pairs is None else maps.pairs
        albedo = finish(solver.albedo(found, lobes))
        textures = dict.fromkeys([found, albedo, maps.roughness, maps.detail])
        result = [device.read(texture).copy() for texture in textures]
        for thing in (*textures, solver, source):
            thing.release()
        return [*result, np.array(solver.noise_of[lobes].neighbours)]

    return job


@pytest.mark.parametrize("method", ["refined", "draft", "swarm"])
@pytest.mark.parametrize("spec", [{}, {"noise": 0.01}, {"model": "two-lobe"}, {"model": "two-lobe", "noise": 0.01}],
                         ids=lambda spec: " ".join(map(str, spec.values())) or "clean")
def test_search_table_polish_and_albedo_are_the_same(both, method, spec):
    """To float32 in all but the few texels where rounding decides between two valleys."""
    drawn, computed = both(run(exact(views=8, **spec)[1], 2 if "model" in spec else 1, method))
    assert bool(drawn[-1]) is bool(computed[-1]) is ("noise" in spec)  # table.kernel ran, or did not
    for a, b in zip(drawn[:-1], computed[:-1], strict=True):
        assert a.shape == b.shape == (SIZE, SIZE, 4)
        assert np.isfinite(b).all()
        off = np.abs(a - b) / (np.abs(a) + 1e-3)
        assert (off.max(-1) < 1e-3).mean() > 0.97
        assert np.median(off) < 1e-6


def test_beckmann_is_the_same(both):
    drawn, computed = both(run(exact(views=8, model="two-lobe")[1], 2, "refined", ndf="beckmann"))
    off = np.abs(drawn[0] - computed[0]).max(-1)
    assert (off < 1e-3).mean() > 0.95


def test_the_paper_is_the_same(both):
    """Chaotic, so after few passes: seven outputs at once, the most that a kernel has but for the table."""

    def job(device: Device) -> list[np.ndarray]:
        source = exact()[1].source(device)
        swarm = PaperSwarm(device, source, SolveSettings(size=SIZE, method="paper", iterations=5), "two-lobe")
        maps = finish(swarm.solve())
        result = [device.read(texture).copy() for texture in (maps.best, maps.more)]
        for thing in (maps.best, maps.more, swarm, source):
            thing.release()
        return result

    drawn, computed = both(job)
    for a, b in zip(drawn, computed, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-3, atol=1e-4)


def test_compute_keeps_within_its_region(both):
    """What lies beside a region stays as it was, whatever the size of work groups."""

    def job(device: Device) -> list[np.ndarray]:
        target = device.framebuffer([device.texture(24, 24)])
        target.clear(7.0, 7.0, 7.0, 7.0)
        device.kernel("device/compute_probe.kernel", target, Inputs(uniforms={"u_steps": 1}),
                      region=(3, 5, 13, 9))
        texture = target.color_attachments[0]
        result = device.read(texture).copy()
        texture.release()
        target.release()
        return [result]

    (drawn,), (computed,) = both(job)
    inside = np.zeros((24, 24), bool)
    inside[5:14, 3:16] = True
    assert (computed[~inside] == 7).all()
    assert (computed[inside] != 7).all()
    np.testing.assert_allclose(computed, drawn, rtol=1e-6)


def test_which_is_faster_is_measured_once():
    """By the probe, as fragment and as compute shader; asked again it runs nothing."""
    done = subprocess.run([sys.executable, "-c", MEASURE], cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr
    compute, first, second = done.stdout.split()
    assert compute in ("True", "False")
    assert first in ("8", "0")  # four times each way; not at all below OpenGL 4.3
    assert second == first


MEASURE = """
from irpso_addon.gpu.device import context
counted = 0
original = context.Device.kernel
def kernel(self, name, *arguments, **more):
    global counted
    counted += name == "device/compute_probe.kernel"
    original(self, name, *arguments, **more)
context.Device.kernel = kernel
device = context.Device()
device.is_software = False  # which would measure nothing
first = device.prefers_compute
before = counted
assert device.prefers_compute is first
print(first, before, counted)
device.release()
"""


def test_a_software_renderer_measures_nothing(on_gl, monkeypatch):
    """It has one processor for both kinds of shaders: kernels run as fragment shaders at once."""

    def job(device: Device) -> bool:
        if not device.is_software:
            pytest.skip("not a software renderer")
        monkeypatch.setattr(device, "settings", DeviceSettings())
        monkeypatch.setattr(device, "compute_faster", None)
        monkeypatch.setattr(Device, "_probe", lambda *_: pytest.fail("measured"))
        return device.prefers_compute

    assert on_gl(job) is False


def test_the_settings_decide(on_gl):
    """Asked for, kernels run so, unmeasured; a device that cannot says what it would need."""

    def job(device: Device) -> list[Any]:
        device.configure(DeviceSettings())
        found: list[Any] = [device.prefers_compute]
        kernels = len(device.programs._kernels)
        for name in ("compute", "fragment", "auto"):
            if name == "compute" and device.ctx.version_code < 430:
                with pytest.raises(BadInput, match=r"Shaders Compute: .* shaders need 4\.3; set Shaders to Auto"):
                    device.configure(DeviceSettings(kernels=name))
                found.append(True)
                continue
            device.configure(DeviceSettings(kernels=name))
            found.append(device.prefers_compute)
        assert device.settings == DeviceSettings()
        return [*found, len(device.programs._kernels) - kernels]

    auto, compute, fragment, again, built = on_gl(job)
    assert (compute, fragment, built) == (True, False, 0)
    assert again == auto


def test_what_was_configured_reaches_the_device(on_gl):
    """Also one that is there already."""
    settings = DeviceSettings(kernels="fragment", memory=0.5, slice=40)
    try:
        thread.configure(settings)
        assert thread.settings() == settings
        assert on_gl(lambda device: (device.settings, device.prefers_compute)) == (settings, False)
    finally:
        thread.configure(DeviceSettings())


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the version is overridden by a Mesa variable")
def test_a_driver_without_compute_shaders_solves(on_gl):
    """OpenGL 4.1, as on a Mac: no probe, no compute shader, the same roughness."""
    if "mesa" not in str(on_gl(lambda device: device.describe())).lower():
        pytest.skip("not a Mesa driver")
    done = subprocess.run([sys.executable, "-c", OLD], cwd=ROOT, capture_output=True, text=True, timeout=120,
                          env={**os.environ, "MESA_GL_VERSION_OVERRIDE": "4.1", "MESA_GLSL_VERSION_OVERRIDE": "410"})
    assert done.returncode == 0, done.stdout + done.stderr
    version, compute, kernels, error = done.stdout.split()
    assert (version, compute, kernels) == ("410", "False", "0")
    assert float(error) < 1e-3


OLD = """
import numpy as np
from irpso_addon.core.params import SolveSettings
from irpso_addon.gpu.device.context import Device
from irpso_addon.gpu.solve.solver import Solver
from tests.support.texels import exact, finish
device = Device()
problem, texels = exact()
solver = Solver(device, texels.source(device), SolveSettings(size=32))
found = device.read(finish(solver.solve()).roughness)[..., 0]
print(device.ctx.version_code, device.prefers_compute, len(device.programs._kernels),
      np.abs(found - problem.truth.roughness).mean())
"""
