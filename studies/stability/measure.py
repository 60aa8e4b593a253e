"""What is recorded of every point: errors, how sure the method said it was, and what the product warns of."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from irpso_addon.core.data import F64, Bool
from tests.support.texel_problem import FAILED

from .methods import Answer
from .problem import Problem

GROSS = 0.15  # an error of roughness above this, on more than ...
GROSS_SHARE = 0.10  # ... this share of a map, must be warned of
WORST = 0.01  # share of texels
UNSURE = 0.5  # a confidence below says so: a standard error of roughness above HALF_SURE
Record = dict[str, Any]


def record(
    problem: Problem, answer: Answer, part: tuple[slice, slice] | None = None,
    warnings: list[tuple[str, str]] | None = None,
) -> Record:
    """Of one map; ``part``: the texels that were answered for; ``warnings``: kinds and texts of the product's."""
    where = part or (slice(None), slice(None))
    error = roughness_error(problem, answer, where)
    solved = answer.solved
    base = (answer.base - problem.truth.base[where])[solved]
    values = [answer.roughness, answer.base] + [v for v in (answer.sigma, answer.confidence) if v is not None]
    wrong = error > FAILED
    found: Record = {
        "texels": int(solved.sum()), "seen": float(solved.mean()),
        "nan": int(sum((~np.isfinite(v)).sum() for v in values)),
        "roughness": _mean(error), "failures": _mean(wrong), "gross": _mean(error > GROSS),
        "worst": float(np.sort(error)[-max(int(np.ceil(WORST * error.size)), 1):].mean()) if error.size else 0.0,
        "albedo": float(np.sqrt((base**2).mean())) if error.size else 0.0,
    }
    if answer.confidence is not None:
        told = answer.confidence[solved]
        low = worst_half(told)
        found |= {"failed": int(wrong.sum()), "failed_low": int((wrong & low).sum()),
                  "failed_told": int((wrong & (low | (told < UNSURE))).sum()), "unsure": _mean(told < UNSURE)}
    if answer.prediction is not None:
        found |= {"taken": answer.prediction.taken, "predicted": answer.prediction.error.relative_rms,
                  "lightness": answer.prediction.error.lightness}
    if warnings is not None:
        found["warnings"] = warnings
    return {k: float(f"{v:.5g}") if isinstance(v, float) else v for k, v in found.items()}


def roughness_error(problem: Problem, answer: Answer, where: tuple[slice, slice]) -> F64:
    """Absolute, of the solved texels."""
    return np.asarray(np.abs(answer.roughness - problem.truth.roughness[where])[answer.solved])


def worst_half(confidence: F64) -> Bool:
    """Which values lie in the lower half; of equal ones at the middle all."""
    return np.asarray(confidence <= np.median(confidence)) if confidence.size else np.zeros(0, bool)


def _mean(values: F64) -> float:
    return float(np.mean(values)) if values.size else 0.0


def summary(records: Sequence[Record]) -> Record:
    """Of one method at one point, over its seeds."""
    told = [r for r in records if r["texels"]]
    found: Record = {"seeds": len(records), "nan": sum(r["nan"] for r in records),
                     "seen": float(np.mean([r["seen"] for r in records]))}
    judged = [r for r in told if "taken" in r]
    if judged:
        found |= {key: float(np.mean([r[key] for r in judged])) for key in ("predicted", "lightness")}
        found["taken"] = _counts(r["taken"] for r in judged)
    for key in ("roughness", "failures", "gross", "worst", "albedo"):
        values = np.array([r[key] for r in told]) if told else np.zeros(1)
        found[key], found[f"{key}_spread"] = float(values.mean()), float(values.std())
    found["gross_maps"] = sum(is_gross(r) for r in told)
    if all("failed" in r for r in records):
        low = [r for r in told if r["failures"] <= 0.5]  # where more than half fail they are not in any half
        for key in ("failed", "failed_low", "failed_told"):
            found[key] = sum(r[key] for r in told)
        found["halved"], found["halved_low"] = sum(r["failed"] for r in low), sum(r["failed_low"] for r in low)
        found["unsure"] = float(np.mean([r["unsure"] for r in told])) if told else 1.0
    if all("warnings" in r for r in records):
        found["warned_maps"] = sum(bool(r["warnings"]) for r in records)
        found["unwarned"] = sum(is_gross(r) and not r["warnings"] for r in records)
        found["kinds"] = _kinds(records)
    return {k: float(f"{v:.5g}") if isinstance(v, float) else v for k, v in found.items()}


def is_gross(r: Record) -> bool:
    """Whether a map must not go without a warning."""
    return bool(r["texels"]) and r["gross"] > GROSS_SHARE


def _kinds(records: Iterable[Record]) -> dict[str, int]:
    """How many maps each kind of warning was given for."""
    return _counts(kind for r in records for kind in {kind for kind, _ in r["warnings"]})


def _counts(names: Iterable[str]) -> dict[str, int]:
    """How often each is there, the most frequent first."""
    return dict(Counter(names).most_common())
