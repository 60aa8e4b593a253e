"""Jobs made of jobs: who hears of a stop, what comes back, what is cleaned up; and what a job is handed."""

from __future__ import annotations

import pickle
import re
import threading
from dataclasses import replace
from pathlib import Path

import pytest

from irpso_addon.core.errors import Cancelled, StoppedWithWork
from irpso_addon.core.job import Mailbox, Progress, Steps, mapped, retold

ROOT = Path(__file__).parents[2]
TASK = re.compile(r"""["'](\w+(?:\.\w+)*):([a-z_]\w*)["'][,)]""")


def worker(seen: list[str], answers: bool = True) -> Steps[str]:
    """Three steps; stopped, it answers with what it has, or not."""
    try:
        for n in range(3):
            try:
                yield Progress(n / 3, "work", f"{n}")
            except Cancelled:
                seen.append(f"stopped at {n}")
                if not answers:
                    raise
                yield Progress(1.0, "work", "finishing")
                return "part"
        return "whole"
    finally:
        seen.append("clean")


def halved(step: Progress) -> Progress:
    return replace(step, fraction=step.fraction / 2)


def nested(seen: list[str], answers: bool = True, keeps: bool = True) -> Steps[str]:
    """Two deep, each with something to clean up."""
    try:
        found = yield from mapped(mapped(worker(seen, answers), halved), halved, keeps=keeps)
        return f"{found}, passed on"
    finally:
        seen.append("outer clean")


def end_of(steps: Steps[str]) -> str:
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return str(end.value)


def test_steps_are_made_the_wholes_own_and_the_value_comes_back() -> None:
    seen: list[str] = []
    steps = nested(seen)
    assert [next(steps).fraction for _ in range(3)] == pytest.approx([0, 1 / 12, 2 / 12])
    assert end_of(steps) == "whole, passed on"
    assert seen == ["clean", "outer clean"]


def test_a_stop_reaches_the_innermost_which_may_answer() -> None:
    seen: list[str] = []
    steps = nested(seen)
    next(steps)
    next(steps)
    assert steps.throw(Cancelled()) == Progress(0.25, "work", "finishing")
    assert end_of(steps) == "part, passed on"
    assert seen == ["stopped at 1", "clean", "outer clean"]


def test_a_stop_that_nobody_answers_comes_out_once_all_is_clean() -> None:
    seen: list[str] = []
    steps = nested(seen, answers=False)
    next(steps)
    with pytest.raises(Cancelled):
        steps.throw(Cancelled())
    assert seen == ["stopped at 0", "clean", "outer clean"]


def test_what_keeps_nothing_is_ended_where_it_is() -> None:
    seen: list[str] = []
    steps = nested(seen, keeps=False)
    next(steps)
    with pytest.raises(Cancelled):
        steps.throw(Cancelled())
    assert seen == ["clean", "outer clean"]
    steps = retold(worker(seen), halved)
    next(steps)
    with pytest.raises(Cancelled):
        steps.throw(Cancelled())
    assert seen[2:] == ["clean"]


def test_a_job_that_is_left_or_cannot_be_retold_is_closed() -> None:
    seen: list[str] = []
    steps = nested(seen)
    next(steps)
    steps.close()
    assert seen == ["clean", "outer clean"]

    def broken(step: Progress) -> Progress:
        raise ValueError(step.message)

    with pytest.raises(ValueError, match="0"):
        next(mapped(worker(seen), broken))
    assert seen[2:] == ["clean"]


def test_a_mailbox_gives_the_latest() -> None:
    box = Mailbox()
    assert box.take(0.0) is None
    box.put("old")
    box.put("new")
    assert box.take(0.0) == "new"
    assert box.take(0.0) is None
    threading.Timer(0.05, box.put, ("late",)).start()
    assert box.take(30.0) == "late"


@pytest.mark.parametrize("stop", [Cancelled({"maps": 1}), StoppedWithWork(Path("work"), 3)])
def test_a_stop_goes_through_a_pipe(stop: Cancelled) -> None:
    again = pickle.loads(pickle.dumps(stop))
    assert type(again) is type(stop)
    assert vars(again) == vars(stop)


def test_tasks_that_are_named_are_there() -> None:
    """Modules move; a name in a text does not."""
    found = set()
    for folder in ("irpso_addon", "operators"):
        for path in (ROOT / folder).rglob("*.py"):
            for line in path.read_text(encoding="utf-8").splitlines():
                if re.search(r"\b(Remote|Task|_start|run)\(", line):
                    found |= set(TASK.findall(line))
    assert len(found) > 5
    for module, function in found:
        file = ROOT / "irpso_addon" / Path(*module.split(".")).with_suffix(".py")
        assert re.search(rf"^def {function}\(", file.read_text(encoding="utf-8"), re.M), f"{module}:{function}"
