"""A small form of ``python -m studies.fuzz``, and that it notices what it is there for."""

from __future__ import annotations

import os
import sys

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from irpso_addon.core.capture.captures import read_captures
from irpso_addon.core.errors import BadInput
from irpso_addon.core.storage.text_file import MOST
from studies.fuzz import worker
from studies.fuzz.__main__ import SHARES, table
from studies.fuzz.drive import Driver, Results
from studies.fuzz.kinds import captures, images, texts, traps

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="asks Linux about its processes")


def run(folder, wanted, jobs=2, hang=10.0):
    """Outcomes by kind, in order."""
    results = Results(folder)
    Driver(results, 0, jobs, folder / "log.txt", hang).run({kind: range(n) for kind, n in wanted.items()})
    return {kind: sorted(results.of(kind).values(), key=lambda o: o.index) for kind in wanted}


def test_the_harness_notices(tmp_path):
    outcomes = run(tmp_path, {"traps": len(traps.WANTED)}, jobs=1, hang=2.0)["traps"]
    told = {what: o for what, o in zip(traps.WANTED, outcomes, strict=True)}
    assert {what: o.verdict for what, o in told.items()} == {
        "accepted": "accepted", "stray": "accepted", "stray from outside Python": "accepted", "memory": "accepted",
        "refused": "refused", "no name": "refused", "two lines": "refused", "crash": "crash", "died": "crash",
        "hang": "hang"}
    assert {what for what, o in told.items() if o.bad} == {*traps.WANTED} - {"accepted", "refused"}
    assert {what for what, o in told.items() if o.stray} == {"stray", "stray from outside Python"}
    assert {what for what, o in told.items() if o.nameless} == {"no name", "two lines"}
    assert [what for what, o in told.items() if o.over] == ["memory"]
    assert "ValueError: a bug" in told["crash"].message and "SIGABRT" in told["died"].message
    assert "| traps | 10 | 4 | 3 | 2 | 1 | 2 | 2 | 1 |" in table({"traps": outcomes})


def test_a_stopped_run_goes_on(tmp_path):
    first = run(tmp_path, {"texts": 5}, jobs=1)["texts"]
    with (tmp_path / "texts.jsonl").open("a") as file:
        file.write('{"index": 5, "verd')  # killed while it wrote
    again = run(tmp_path, {"texts": 8}, jobs=1)["texts"]
    assert [o.index for o in again] == list(range(8)) and again[:5] == first


def test_small_form(tmp_path):
    found = run(tmp_path, {kind: max(8, 250 * share // 100_000) for kind, share in SHARES.items()
                           if kind != "solves"})  # whose shaders take seconds to compile; other tests solve
    bad = [(kind, o.index, o.verdict, o.stray, o.message) for kind, outcomes in found.items() for o in outcomes
           if o.bad]
    assert not bad, f"python -m studies.fuzz --replay KIND:NUMBER shows one: {bad[0]} and {len(bad) - 1} more"
    verdicts = {kind: {o.verdict for o in outcomes} for kind, outcomes in found.items()}
    assert all({"accepted", "refused"} <= seen for kind, seen in verdicts.items() if kind != "blends"), verdicts


@pytest.mark.parametrize("kind", [captures, images, texts])
def test_any_choice_of_the_generator(kind, tmp_path_factory):
    """As the runs by number, but hypothesis chooses, and finds the smallest case that fails."""
    folder = tmp_path_factory.mktemp(kind.__name__)
    shared, name = kind.prepare(folder), kind.__name__.rpartition(".")[2]

    @settings(max_examples=40, deadline=None, database=None, suppress_health_check=list(HealthCheck))
    @given(st.randoms(use_true_random=False))
    def any_case(rng):
        outcome = worker.run_case(name, shared, rng, 0, folder / "box")
        assert not outcome.bad, outcome.message

    any_case()


@pytest.mark.parametrize("place", ["pipe", "device", "folder", "loop", "long name", "large", "not text"])
def test_places_that_are_no_capture_file(place, tmp_path):
    path = tmp_path / "captures.json"
    match place:
        case "pipe":
            os.mkfifo(path)
        case "device":
            path.symlink_to("/dev/zero")
        case "folder":
            path.mkdir()
        case "loop":
            path.symlink_to(path.name)
        case "long name":
            path = tmp_path / ("n" * 300)
        case "large":
            with path.open("wb") as file:
                file.truncate(MOST + 1)
        case "not text":
            path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(BadInput, match=path.name):
        read_captures(path)


def test_messages_are_one_printable_line():
    assert str(BadInput("a\nb\x1b[2J\u202e\udcff: ü 日本")) == "a?b?[2J??: ü 日本"
