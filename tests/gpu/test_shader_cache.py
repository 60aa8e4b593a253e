"""What Mesa keeps on disk of the programs it has compiled: all that a solve needs, from the first time on."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

DRAWS = """
from irpso_addon.gpu.device.context import Device, Inputs

device = Device()
for size in ((16, 16), (12, 12), (16, 12), (32, 8)):
    with device.scope(), device.target([device.texture(8, 8)]) as target:
        device.draw("maps/fill_down.frag", target, Inputs({"u_map": device.texture(*size)}))
device.budget.finish()
print(device.is_software)
"""


def test_textures_of_all_sizes_are_compiled_for_once(tmp_path: Path) -> None:
    """A second process finds compiled what the first one drew, whether sides are powers of two or not."""

    def kept() -> dict[Path, int]:  # bytes: newer versions of Mesa have one file for all
        ran = subprocess.run([sys.executable, "-c", DRAWS], check=True, capture_output=True, text=True, env={
            **os.environ, "MESA_SHADER_CACHE_DIR": str(tmp_path), "MESA_SHADER_CACHE_DISABLE": "false"})
        if ran.stdout.strip() != "True":
            pytest.skip("only Mesa's software renderer compiles for sizes")
        return {path: path.stat().st_size for path in tmp_path.rglob("*") if path.is_file()}

    first = kept()
    assert first
    assert kept() == first
