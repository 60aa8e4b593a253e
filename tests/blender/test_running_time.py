"""Progress never goes back, pauses do not count, and the time left is near the truth where the estimate is."""

from __future__ import annotations

from itertools import pairwise

from hypothesis import given, settings
from hypothesis import strategies as st

from irpso_addon.blender.jobs.running_time import MOST, RunningTime


class Clock:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@settings(max_examples=200, deadline=None)
@given(st.lists(st.tuples(st.floats(0, 5), st.floats(0, 1), st.booleans()), max_size=40),
       st.one_of(st.none(), st.floats(0.1, 100)))
def test_it_never_goes_back(steps, expected) -> None:
    clock = Clock()
    running = RunningTime(expected, clock)
    fraction, left, done = 0.0, None, 0.0
    for seconds, more, paused in steps:
        running.pause(paused)
        clock.now += seconds
        done = max(done, more)
        running.update(done)
        assert fraction <= running.fraction <= MOST
        assert left is None or (running.left is not None and running.left <= left)
        fraction, left = running.fraction, running.left


def test_a_stage_that_takes_long_does_not_stop_the_bar() -> None:
    """22 s, of which the job's own fraction stands at 60 % for 10; the estimate is a quarter too low."""
    clock = Clock()
    running, told = RunningTime(17.0, clock), []
    for second in range(1, 22):
        clock.now += 1
        running.update(0.6 * second / 8 if second < 8 else 0.6 if second < 18 else 0.6 + 0.1 * (second - 18))
        told.append(running.fraction)
    assert all(later > earlier for earlier, later in pairwise(told[:16]))
    assert told[10] > 0.45


def test_an_estimate_that_is_far_too_low_is_given_up() -> None:
    clock = Clock()
    running = RunningTime(7.0, clock)
    told = []
    for second in range(1, 50):
        clock.now += 1
        running.update(second / 50)
        told.append(running.fraction)
    assert all(later > earlier for earlier, later in pairwise(told))
    assert told[6] < 0.4 and told[24] < 0.62


def test_pauses_do_not_count() -> None:
    clock = Clock()
    running = RunningTime(10.0, clock)
    clock.now += 4
    running.pause(True)
    running.pause(True)
    clock.now += 1000
    running.update(0.4)
    assert abs(running.seconds - 4) < 1e-9 and running.left is not None and 5 < running.left < 7
    running.pause(False)
    clock.now += 1
    assert abs(running.seconds - 5) < 1e-9
