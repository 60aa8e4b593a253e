"""Jobs in a worker process: what comes back, when it ends, and what is seen on the way."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.core.data import SceneData, Solution
from irpso_addon.core.errors import BadInput, Cancelled, DeviceLost
from irpso_addon.core.images.image_writer import write_image
from irpso_addon.core.live_maps import Live
from irpso_addon.core.params import DeviceSettings, SolveSettings
from irpso_addon.gpu.device import thread
from irpso_addon.process import remote
from irpso_addon.solve import pipeline
from tests.support import synthetic as syn

PATIENCE = 60.0  # seconds; far more than any of these jobs needs
SETTINGS = SolveSettings(size=64, model="one-lobe")


@pytest.fixture(scope="module")
def filed(patches: syn.Shoot, tmp_path_factory: pytest.TempPathFactory) -> SceneData:
    """The scene with its pictures in files, as another process can read them."""
    folder = tmp_path_factory.mktemp("pictures")
    views = []
    for n, view in enumerate(patches.scene.views):
        path = folder / f"{n}.exr"
        write_image(path, patches.read_image(view).rgb, kind="exr", color=True)
        views.append(replace(view, image=path))
    return replace(patches.scene, views=tuple(views))


@pytest.fixture(scope="module")
def warm() -> Iterator[remote.Worker]:
    """A worker that has compiled what previews need."""
    worker = remote.Worker(DeviceSettings())
    job = remote.Remote("solve.preview:warm_up", worker=worker)
    assert job.wait(PATIENCE)
    job.result()
    yield worker
    worker.close()


def until(true: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE
    while not true():
        assert time.monotonic() < end
        time.sleep(0.005)


def test_a_solve_is_the_same_as_here_and_pictures_show_what_it_predicts(filed: SceneData) -> None:
    job = remote.Remote("solve.pipeline:solve", filed, SETTINGS)
    looks: list[Live] = []
    fractions: list[float] = []
    while not job.wait(0.01):
        looks += job.looks()
        if (progress := job.poll()) is not None:
            fractions.append(progress.fraction)
    there: Solution = job.result()
    here: Solution = thread.run(lambda: pipeline.solve(filed, SETTINGS))
    np.testing.assert_array_equal(there.maps.roughness, here.maps.roughness)
    np.testing.assert_array_equal(there.maps.base_color, here.maps.base_color)
    assert fractions == sorted(fractions)
    assert max(fractions) > 0.5
    assert len(there.pictures) == len(filed.views)
    for picture in there.pictures:
        told = np.isfinite(picture.reference) & np.isfinite(picture.predicted)
        assert told.mean() > 0.3
        reference, predicted = picture.reference[told].astype(float), picture.predicted[told].astype(float)
        assert np.median(np.abs(reference - predicted)) < 0.01 * np.median(reference)
    # What was seen on the way is the result, where it was known.
    last = [look.maps["roughness"] for look in looks if np.isfinite(look.maps.get("roughness", np.nan)).any()]
    if last:
        known = np.isfinite(last[-1]) & ~there.maps.filled
        assert np.median(np.abs(last[-1] - there.maps.roughness)[known]) < 0.01


def test_bad_input_arrives_as_what_it_is(filed: SceneData) -> None:
    missing = replace(filed, views=(replace(filed.views[0], image=Path("/nowhere/a.exr")),))
    job = remote.Remote("solve.pipeline:solve", missing, SETTINGS)
    with pytest.raises(BadInput, match=r"a\.exr"):
        job.result()


def test_a_stop_waits_for_nobody_and_takes_the_process_along(filed: SceneData, monkeypatch) -> None:
    """The process stands still and cannot end: who stops the job is free all the same, and asked for its end once."""
    job = remote.Remote("solve.pipeline:solve", filed, replace(SETTINGS, size=1024))
    until(lambda: job.poll() is not None)
    process, told = job.worker._process, []
    os.kill(process.pid, signal.SIGSTOP)
    monkeypatch.setattr(process, "kill", lambda: told.append(("kill", job.done)))
    monkeypatch.setattr(process, "wait", lambda *_, **__: told.append(("wait", job.done)))
    stop = threading.Thread(target=job.cancel, daemon=True)
    stop.start()
    stop.join(PATIENCE)
    monkeypatch.undo()
    assert not stop.is_alive()
    assert told == [("kill", True)]
    assert job.done and job.worker.alive
    with pytest.raises(Cancelled):
        job.result()
    process.kill()
    until(lambda: not job.worker.alive)


def test_a_worker_that_dies_is_told_of(filed: SceneData) -> None:
    job = remote.Remote("solve.pipeline:solve", filed, replace(SETTINGS, size=1024))
    until(lambda: job.poll() is not None)
    os.kill(job.worker._process.pid, signal.SIGKILL)
    with pytest.raises(DeviceLost, match=r"worker process ended \(status -9\).*lower Memory"):
        job.result()


def test_a_job_that_is_held_stands_still(filed: SceneData) -> None:
    job = remote.Remote("solve.pipeline:solve", filed, replace(SETTINGS, size=512))
    until(lambda: (p := job.poll()) is not None and p.stage == "solve")
    job.pause(True)
    time.sleep(0.7)  # the step that it was in
    held = job.poll()
    time.sleep(0.7)
    assert job.poll() == held
    job.pause(False)
    until(lambda: job.done or job.poll() != held)
    job.cancel()


def test_a_preview_comes_closer_from_look_to_look(filed: SceneData, warm: remote.Worker, patches: syn.Shoot) -> None:
    job = remote.Remote("solve.preview:preview", filed, replace(SETTINGS, size=512), worker=warm)
    looks: list[Live] = []
    until(lambda: bool(looks.extend(job.looks())) or sum(bool(look.pictures) for look in looks) >= 3)
    assert set(looks[0].maps) == {"base_color"}  # is there at once
    assert looks[0].coverage is not None
    matte, *whole = [look for look in looks if look.pictures]
    assert matte.error > 2 * whole[0].error
    assert whole[1].maps["roughness"].shape == (256, 256)
    at = (np.arange(256) + 0.5) / 256
    u, v = np.meshgrid(at, at)
    off = np.abs(whole[1].maps["roughness"] - patches.truth.roughness(u, v))[whole[1].coverage]
    assert np.median(off) < 0.05
    assert whole[1].error < 0.1
    # Maps that are fed are judged: wrong ones explain the pictures worse.
    job.feed({"base_color": np.full((64, 64, 3), 0.9, np.float32), "roughness": np.full((64, 64), 0.9, np.float32)})
    judged: list[Live] = []
    until(lambda: bool(judged.extend(job.looks())) or any(not look.maps for look in judged))
    assert next(look for look in judged if not look.maps).error > 3 * whole[1].error
    job.cancel()
    # The worker lives, and takes the next job.
    again = remote.Remote("solve.preview:warm_up", worker=warm)
    assert again.wait(PATIENCE)
    again.result()
