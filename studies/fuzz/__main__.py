"""Hostile and broken input: ``python -m studies.fuzz --cases 100000``.

Each case is decided by its kind, its number and the seed.  Cases run in processes of their own; results are kept in
build/fuzz, and a run that was stopped goes on where it was.  --replay KIND:NUMBER runs one case here and keeps its
folder.  Exit code 1: some case crashed, stood still, wrote where it may not, or was refused without a name.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path

from . import worker
from .case import Outcome
from .drive import ROOT, Driver, Results

# Of 100,000 cases.
SHARES = {"captures": 40_000, "images": 14_000, "scenes": 12_000, "blends": 2_000, "works": 12_000, "texts": 10_000,
          "commands": 9_000, "solves": 1_000}
COLUMNS = ("kind", "cases", "accepted", "refused", "crashes", "hangs", "stray writes", "no name", "over memory",
           "most MB", "slowest s", "Blender fell")


def main() -> int:
    """Run, print the table and what is wrong."""
    parser = argparse.ArgumentParser(prog="python -m studies.fuzz", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cases", type=int, default=1000, help="of all kinds together (default: 1000)")
    parser.add_argument("--kinds", nargs="+", choices=SHARES, default=list(SHARES), metavar="KIND",
                        help=f"of {', '.join(SHARES)}; default: all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2, help="processes at a time (default: 2)")
    parser.add_argument("--results", type=Path, default=ROOT / "build" / "fuzz", help="default: build/fuzz")
    parser.add_argument("--again", action="store_true", help="run those that were bad again")
    parser.add_argument("--replay", metavar="KIND:NUMBER", help="one case, in this process")
    arguments = parser.parse_args()
    if arguments.replay:
        kind, _, number = arguments.replay.partition(":")
        return replay(kind, int(number), arguments.seed)
    results = Results(arguments.results / f"seed{arguments.seed}")
    whole = sum(SHARES[kind] for kind in arguments.kinds)
    counts = {kind: round(arguments.cases * SHARES[kind] / whole) for kind in arguments.kinds}
    if arguments.again:
        for kind in arguments.kinds:
            results.forget_bad(kind)
    Driver(results, arguments.seed, arguments.jobs, results.folder / "log.txt").run(
        {kind: range(count) for kind, count in counts.items()})
    by_kind = {kind: [o for i, o in results.of(kind).items() if i < count] for kind, count in counts.items()}
    print(table(by_kind))
    troubles = [(kind, outcome) for kind, outcomes in by_kind.items() for outcome in outcomes if outcome.bad]
    alike: dict[str, list[tuple[str, Outcome]]] = {}
    for kind, outcome in troubles:
        alike.setdefault(signature(kind, outcome), []).append((kind, outcome))
    for cases in sorted(alike.values(), key=len, reverse=True):
        (kind, outcome), count = cases[0], len(cases)
        print(f"\n{count} like {kind}:{outcome.index} ({outcome.verdict}, {outcome.stray}, {outcome.memory:,} bytes)")
        print(outcome.message[-1500:])
    return 1 if troubles else 0


def signature(kind: str, outcome: Outcome) -> str:
    """What cases with the same cause share: where it happened, and what kind of error it was."""
    lines = outcome.message.splitlines() or [""]
    places = [line for line in lines if line.strip().startswith("File ")]
    why = (places[-1] if places else "") + lines[-1][:30] if outcome.verdict == "crash" else ""
    return f"{kind} {outcome.verdict} {bool(outcome.stray)} {outcome.nameless} {outcome.over} {why}"


def table(by_kind: dict[str, list[Outcome]]) -> str:
    """Lines of Markdown."""
    rows = [row(kind, outcomes) for kind, outcomes in by_kind.items()]
    rows.append(row("all", [outcome for outcomes in by_kind.values() for outcome in outcomes]))
    lines = [COLUMNS, tuple("---:" if i else "---" for i in range(len(COLUMNS))), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def row(kind: str, outcomes: list[Outcome]) -> tuple[str, ...]:
    """One row of it."""
    def count(verdict: str) -> int:
        return sum(outcome.verdict == verdict for outcome in outcomes)

    numbers = (len(outcomes), count("accepted"), count("refused"), count("crash"), count("hang"),
               sum(bool(o.stray) for o in outcomes), sum(o.nameless for o in outcomes), sum(o.over for o in outcomes),
               round(max((o.memory for o in outcomes), default=0) / 1e6))
    slowest = max((o.seconds for o in outcomes), default=0.0)
    return (kind, *(f"{n:,}" for n in numbers), f"{slowest:.1f}", f"{count('blender'):,}")


def replay(kind: str, number: int, seed: int) -> int:
    """One case, with all that it says."""
    folder = Path(tempfile.mkdtemp(prefix="irpso-fuzz-"))
    shared = worker.importlib.import_module(f".kinds.{kind}", __package__).prepare(folder)
    outcome = worker.run_case(kind, shared, worker.random_of(kind, seed, number), number, folder / "box", keep=True)
    message = outcome.message
    outcome.message = ""
    print(json.dumps(outcome.__dict__, indent=1), message, f"kept: {folder}", sep="\n")
    return 1 if outcome.bad else 0


if __name__ == "__main__":
    sys.exit(main())
