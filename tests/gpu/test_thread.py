"""The GL thread: who runs where, what comes back, and how a job is stopped."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import weakref
from pathlib import Path
from textwrap import dedent
from types import SimpleNamespace

import pytest

from irpso_addon.core.errors import BadInput, Cancelled
from irpso_addon.core.job import Progress
from irpso_addon.gpu.device import thread

ROOT = Path(__file__).resolve().parents[2]
PATIENCE = 20.0  # seconds; far more than any of these jobs needs


def one_step(value):
    def job():
        yield Progress(1.0, "test")
        return value
    return job


def test_opengl_lives_on_its_own_thread_only():
    with pytest.raises(RuntimeError, match="outside its thread"):
        thread.device()

    def job():
        yield Progress(0.5, "test")
        return threading.current_thread(), thread.device(), thread.device().describe()["renderer"]

    where, first, renderer = thread.run(job)
    again, second, _ = thread.run(job)
    assert where is again
    assert where is not threading.current_thread()
    assert first is second  # one context in a process
    assert renderer
    with pytest.raises(RuntimeError, match="outside its thread"):
        thread.device()


def test_run_returns_the_value():
    assert thread.run(one_step({"answer": 42})) == {"answer": 42}


def test_a_job_has_one_thread_for_linear_algebra():
    """In a process of its own: NumPy's threads are as many as there were when it was loaded."""
    program = """
        import numpy
        from threadpoolctl import threadpool_info
        from irpso_addon.gpu.device import thread

        def threads():
            return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}

        def job():
            return threads()
            yield

        print(threads(), thread.run(job), threads())
    """
    done = subprocess.run([sys.executable, "-c", dedent(program)], env={**os.environ, "OPENBLAS_NUM_THREADS": "2"},
                          cwd=ROOT, capture_output=True, text=True)
    assert done.stdout == "{2} {1} {2}\n", done.stderr


def test_run_returns_the_value_of_a_job_without_steps():
    def job():
        return "at once"
        yield

    assert thread.run(job) == "at once"


@pytest.mark.parametrize("error", [BadInput("a.exr: broken; replace it"), ValueError("bug"), KeyboardInterrupt()])
def test_run_raises_what_the_job_raised(error):
    def job():
        yield Progress(0.1, "test")
        raise error

    with pytest.raises(type(error)) as caught:
        thread.run(job)
    assert caught.value is error
    assert thread.run(one_step("still alive")) == "still alive"


def test_run_raises_what_the_function_itself_raised():
    def job():
        raise BadInput("nothing to do")

    with pytest.raises(BadInput, match="nothing to do"):
        thread.run(job)


def test_progress_arrives_in_the_callers_thread():
    seen = threading.Event()
    told = []

    def job():
        yield Progress(0.25, "test", "first")
        assert seen.wait(PATIENCE)  # the job waits for the caller: it has seen the progress while it runs

    def on_progress(step):
        told.append((step, threading.current_thread()))
        seen.set()

    thread.run(job, on_progress)
    assert told == [(Progress(0.25, "test", "first"), threading.current_thread())]


def test_should_stop_cancels_the_job_and_lets_it_clean_up():
    cleaned = []

    def job():
        try:
            while True:
                yield Progress(0.0, "test")
        finally:
            cleaned.append(threading.current_thread().name)

    with pytest.raises(Cancelled) as caught:
        thread.run(job, should_stop=lambda: True)
    assert caught.value.partial is None
    assert cleaned == ["irpso-gl"]
    assert thread.run(one_step("next")) == "next"


def test_a_stopped_job_hands_over_what_it_has():
    partial = SimpleNamespace(cancelled=True, maps="some")

    def job():
        try:
            while True:
                yield Progress(0.0, "test")
        except Cancelled:
            yield Progress(0.9, "test", "winding up")
            return partial

    with pytest.raises(Cancelled) as caught:
        thread.run(job, should_stop=lambda: True)
    assert caught.value.partial is partial


def test_a_job_is_told_once_that_it_is_to_stop():
    asked = []

    def job():
        while len(asked) < 50:
            try:
                yield Progress(0.0, "test")
                if asked:
                    asked.append("step")
            except Cancelled:
                asked.append("stop")
        return SimpleNamespace(cancelled=True)

    with pytest.raises(Cancelled):
        thread.run(job, should_stop=lambda: True)
    assert asked == ["stop"] + ["step"] * 49


def test_a_job_that_was_finished_anyway_keeps_its_result():
    """The stop came too late: the whole result is there and is not thrown away."""
    def job():
        try:
            while True:
                yield Progress(1.0, "test")
        except Cancelled:
            return SimpleNamespace(cancelled=False, maps="all")

    assert thread.run(job, should_stop=lambda: True).maps == "all"


def test_ctrl_c_in_the_caller_stops_the_job():
    def job():
        while True:
            yield Progress(0.0, "test")

    def on_progress(step):
        raise KeyboardInterrupt

    with pytest.raises(Cancelled):
        thread.run(job, on_progress)


def test_an_error_in_the_callers_progress_stops_the_job_too():
    """Nobody waits for that job any more: it must not keep the GL thread busy."""
    stopped, enough = threading.Event(), threading.Event()

    def job():
        try:
            while not enough.is_set():
                yield Progress(0.0, "test")
        except Cancelled:
            stopped.set()

    def on_progress(step):
        raise BrokenPipeError

    with pytest.raises(BrokenPipeError):
        thread.run(job, on_progress)
    told = stopped.wait(2.0)
    enough.set()
    assert told


def test_a_job_runs_beside_its_caller():
    """The modal operator's use: start, poll, result."""
    go = threading.Event()

    def job():
        yield Progress(0.5, "test", "half")
        assert go.wait(PATIENCE)
        yield Progress(1.0, "test", "whole")
        return "done"

    running = thread.Job(job)
    assert not running.done
    assert not running.wait(0.01)
    go.set()
    assert running.wait(PATIENCE)
    assert running.poll() == Progress(1.0, "test", "whole")
    assert running.result() == "done"
    assert running.result() == "done"


def test_jobs_wait_for_one_another():
    order = []
    go = threading.Event()

    def job(name):
        def steps():
            order.append(f"{name} begins")
            yield Progress(0.5, "test")
            assert go.wait(PATIENCE)
            order.append(f"{name} ends")
            return name
        return steps

    first, second = thread.Job(job("first")), thread.Job(job("second"))
    go.set()
    assert (second.result(), first.result()) == ("second", "first")
    assert order == ["first begins", "first ends", "second begins", "second ends"]


def test_a_job_stopped_before_it_began_does_nothing():
    go = threading.Event()
    began = []

    def busy():
        yield Progress(0.0, "test")
        assert go.wait(PATIENCE)

    def never():
        began.append(True)
        yield Progress(0.0, "test")

    first, second = thread.Job(busy), thread.Job(never)
    second.cancel()
    go.set()
    with pytest.raises(Cancelled):
        second.result()
    first.result()
    assert not began


def test_an_error_lets_go_of_what_the_job_held():
    """The error travels with its traceback, but not with the textures of the frames in it."""
    held = []

    def failing():
        textures = [thread.device().texture(4, 4) for _ in range(5)]
        held.extend(weakref.ref(texture) for texture in textures)
        yield Progress(0.0, "test")
        raise BadInput(f"{len(textures)} textures in hand")

    def left():
        yield Progress(0.0, "test")
        return len(thread.device().ctx.objects)

    with pytest.raises(BadInput) as caught:
        thread.run(failing)
    assert caught.value.__traceback__ is not None
    thread.run(one_step(None))
    assert len(held) == 5
    assert not [ref for ref in held if ref() is not None]
    assert thread.run(left) == 0  # the next job has freed them
