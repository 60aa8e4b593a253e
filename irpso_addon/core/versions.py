"""Versions of IRPSO and of what its results depend on."""

from __future__ import annotations

import platform
import tomllib
from importlib import metadata
from pathlib import Path

MANIFEST = Path(__file__).resolve().parents[2] / "blender_manifest.toml"


def version() -> str:
    """IRPSO's own version, from the manifest: the only place it stands."""
    return str(tomllib.loads(MANIFEST.read_text(encoding="utf-8"))["version"])


def versions() -> dict[str, str]:
    """What the result depends on, apart from Blender (core does not know it) and the GL driver."""
    found = {"irpso": version(), "python": platform.python_version(), "platform": platform.platform()}
    for package in ("numpy", "moderngl", "OpenImageIO"):
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:  # Blender's own copy has no package record
            found[package] = "bundled"
    return found
