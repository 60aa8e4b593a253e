"""Runs in Blender: plays the scenario that window.py asked for, tells what it found, quits."""

import importlib
import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import robot

ask = json.loads((robot.FOLDER / "scenario.json").read_text())
module, function = ask["scenario"].split(":")
robot.play(lambda: getattr(importlib.import_module(module), function)(**ask["arguments"]), ask["plain"])
