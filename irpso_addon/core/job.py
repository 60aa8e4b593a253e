"""A long job is a generator of Progress; whoever runs it owns the loop."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Progress:
    """Where a job stands: ``fraction`` of the whole in 0..1, the ``stage`` word, a short ``message``."""

    fraction: float
    stage: str
    message: str = ""
