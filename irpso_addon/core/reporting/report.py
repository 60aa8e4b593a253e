"""report.json: what a solve did, for people, tests and farms.  The keys are told in docs/report.md and stay."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ..change_records import Calibration
from ..check_records import Checks
from ..data import Solution
from ..errors import BadInput
from ..params import SolveSettings
from ..storage.atomic_io import write_whole
from ..versions import versions


def peak_memory() -> int | None:
    """Peak resident memory of this process in bytes; None where the system does not tell."""
    if sys.platform == "win32":
        return None
    import resource  # not there

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024  # macOS counts bytes, Linux KiB


def build_report(
    solution: Solution, settings: SolveSettings, command: Sequence[str], *, blender: str | None = None,
) -> dict[str, Any]:
    """The report of one solve, ready for JSON.  ``blender`` is the version of the Blender that ran it."""
    total = sum(solution.seconds.values())
    solving = solution.seconds.get("solve", 0.0)
    solved = solution.texels.get("solved", 0)
    report = {
        "versions": versions() | ({"blender": blender} if blender else {}),
        "command": list(command),
        **asdict(settings),
        "models": {slot: _model(solution, slot) for slot in solution.model},
        "seconds": {**solution.seconds, "total": total},
        "texels": dict(solution.texels),
        "stride": solution.stride,
        "texels_per_second": {
            "solve": solved / solving if solving else None,
            "total": solved / total if total else None,
        },
        "views": {
            "used": list(solution.views_used),
            "skipped": [{"view": view, "why": why} for view, why in solution.views_skipped],
        },
        "residual": solution.residual,
        "calibration": _calibration(solution.calibration) if solution.calibration else None,
        "cameras": [{**asdict(camera), "image": camera.image and camera.image.name} for camera in solution.cameras],
        "refined_normals": asdict(solution.normals) if solution.normals else None,
        "normals_given_because": solution.normals_why or None,
        "checks": _checks(solution.checks) if solution.checks else None,
        "warnings": list(solution.warnings),
        "device": dict(solution.device),
        "peak_memory_bytes": peak_memory(),
        "cancelled": solution.cancelled,
    }
    return _finite(report)  # type: ignore[no-any-return]  # as it will be in the file


def _model(solution: Solution, slot: str) -> dict[str, Any]:
    """What was solved for in one material, with what only its model has."""
    found: dict[str, Any] = {"model": solution.model[slot], "why": solution.why.get(slot, "")}
    if found["model"] == "one-lobe-specular":
        found["level"] = solution.levels.get(slot)
    elif found["model"] == "one-lobe-metallic":
        found |= {"metallic": solution.metallic.get(slot, 0.0), "level": solution.levels.get(slot, 0.5)}
        if slot in solution.paint:  # share of its texels, whose Metallic is 0
            found["paint"] = solution.paint[slot]
    elif found["model"] == "two-lobe":
        found["ndf"] = solution.ndf
    if slot in solution.coats:
        found["coat"] = asdict(solution.coats[slot])
    if slot in solution.diffuse_roughness:
        found["diffuse_roughness"] = solution.diffuse_roughness[slot]
    prediction = solution.predictions.get(slot)
    if prediction is not None:
        found["prediction"] = {
            "left_out": prediction.left_out, "taken": prediction.taken, "fits": prediction.fits,
            **asdict(prediction.error), "by_light": prediction.by_light, "noise_by_light": prediction.noise_by_light,
            "tried": {name: asdict(error) for name, error in prediction.tried.items()},
            "prior": asdict(solution.priors[slot]) if slot in solution.priors else None}
    return found


def _calibration(calibration: Calibration) -> dict[str, Any]:
    """What was put right, by the names of views."""
    return asdict(calibration) | {
        "exposures": [{**asdict(view), "image": view.image.name} for view in calibration.exposures]}


def _checks(checks: Checks) -> dict[str, Any]:
    """What was measured, all of one view in one place."""
    inside = "name", "sure", "slope", "registration"
    found = {key: value for key, value in asdict(checks).items() if key not in inside}
    shifts = {(m.image.name, m.camera): m for m in checks.registration}
    views = []
    for view in checks.views:
        record = {"view": view.view, "camera": view.camera, "lights": view.lights, "clipped": view.clipped,
                  **asdict(view.residual), "exponent": view.slope.exponent if view.slope else None,
                  "exponent_error": view.slope.error if view.slope else None}
        if misfit := shifts.get((view.view, view.camera)):
            record |= {"shift": misfit.shift, "shift_error": misfit.shift_error, "growth": misfit.growth,
                       "growth_error": misfit.growth_error, "roll": misfit.roll, "roll_error": misfit.roll_error,
                       "bend": misfit.bend, "bend_error": misfit.bend_error, "exposure": misfit.gain,
                       "exposure_error": misfit.gain_error}
        views.append(record)
    return {**found, "views": views, "exponent": checks.slope.exponent if checks.slope else None,
            "exponent_error": checks.slope.error if checks.slope else None}


def write_report(path: Path, report: dict[str, Any]) -> None:
    """Write the report as JSON: whole or not at all.  Raises BadInput where that is impossible."""
    path = Path(path)
    text = json.dumps(_finite(report), indent=1, ensure_ascii=False, allow_nan=False)
    try:
        write_whole(path, f"{text}\n".encode(errors="backslashreplace"))  # file names may be no text
    except OSError as error:
        raise BadInput(f"{path}: cannot be written ({error.strerror}); choose another place") from None


def _finite(value: Any) -> Any:
    """JSON has no NaN and no infinity: they become null."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if hasattr(value, "item"):  # a numpy scalar
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value
