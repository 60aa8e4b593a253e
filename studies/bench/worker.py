"""The rivals in PyTorch, SciPy and Mitsuba, each in a process of its own: ``python -m studies.bench.worker``.

PyTorch's threads and a software OpenGL in one process have crashed each other.  Reads one request a line (JSON), makes
the problem from its spec, answers with one line.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict
from functools import lru_cache
from pathlib import Path
from typing import Any

from tests.support.texel_problem import Problem, Spec, make

ROOT = Path(__file__).resolve().parents[2]


class Worker:
    """The process, seen from the benchmark."""

    def __init__(self) -> None:
        self.process = subprocess.Popen([sys.executable, "-m", "studies.bench.worker"], cwd=ROOT, text=True,
                                        stdin=subprocess.PIPE, stdout=subprocess.PIPE)

    def ask(self, method: str, spec: Spec, budgets: Sequence[int], **more: Any) -> list[dict[str, Any]]:
        """Points (setting, seconds, errors) of one method on one problem; raises RuntimeError with its words."""
        assert self.process.stdin is not None and self.process.stdout is not None
        request = {"method": method, "spec": asdict(spec), "budgets": list(budgets), "more": more}
        self.process.stdin.write(json.dumps(request) + "\n")
        self.process.stdin.flush()
        line = self.process.stdout.readline()
        if not line:
            raise RuntimeError(f"its process ended with {self.process.wait()}")
        answer: dict[str, Any] = json.loads(line)
        if "error" in answer:
            raise RuntimeError(answer["error"])
        points: list[dict[str, Any]] = answer["points"]
        return points

    def close(self) -> None:
        """End the process."""
        with self.process:  # which closes its pipes
            pass


@lru_cache(maxsize=8)
def _problem(spec: Spec) -> Problem:
    return make(spec)


@lru_cache(maxsize=8)
def _data(spec: Spec) -> Any:
    from . import rival_torch

    return rival_torch.Data(_problem(spec))


def answer(method: str, spec: Spec, budgets: Sequence[int], more: dict[str, Any]) -> list[dict[str, Any]]:
    """Run one method at its budgets."""
    problem = _problem(spec)
    if method == "scipy":
        from . import rival_scipy

        results = []
        for starts in budgets:
            seconds, errors = rival_scipy.solve(problem, starts, more["sample"])
            results.append({"setting": f"{starts} starts", "seconds": seconds, **asdict(errors)})
        return results
    if method == "mitsuba":
        from . import mitsuba_plane

        return mitsuba_plane.run(problem, budgets[-1])
    from . import rival_torch

    rival = {"lm": rival_torch.lm, "adam": rival_torch.adam}[method]
    return [{"setting": f"{steps} steps", "seconds": seconds, **asdict(problem.score(found))}
            for steps, seconds, found in rival(_data(spec), spec.model, budgets, more["compiled"])]


def main() -> None:
    """Serve until the input ends."""
    replies = sys.stdout
    sys.stdout = sys.stderr  # whatever a library prints is no answer
    for line in sys.stdin:
        request = json.loads(line)
        start = time.perf_counter()
        try:
            points = answer(request["method"], Spec(**request["spec"]), request["budgets"], request["more"])
            reply: dict[str, Any] = {"points": points, "seconds": time.perf_counter() - start}
        except Exception as error:  # told to the other side, which decides
            reply = {"error": f"{type(error).__name__}: {error}"}
        replies.write(json.dumps(reply) + "\n")
        replies.flush()


if __name__ == "__main__":
    main()
