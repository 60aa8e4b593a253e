"""The same seed gives the same bytes, whatever the tiles and their order: an assertion, also for the whole pipeline."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np

from irpso_addon.core.data import RadianceImage
from irpso_addon.core.params import SolveSettings
from irpso_addon.gpu.device import thread
from irpso_addon.gpu.device.context import Device
from irpso_addon.gpu.observe import observation_atlas
from irpso_addon.gpu.solve import material_solves, model_ladder, solver
from irpso_addon.gpu.solve.paper_swarm import PaperSwarm
from irpso_addon.gpu.solve.solver import Solver
from irpso_addon.solve import pipeline
from studies.bench.opengl import result
from tests.support import shoots
from tests.support import synthetic as syn

from .methods import PictureSource
from .problem import Problem, Trial, make
from .store import FOLDER

TRIALS = {"1 % noise": Trial(noise=0.01), "10 % outliers": Trial(noise=0.01, shadows=0.05, doubled=0.05)}
TILES = ((32, 32), (32, 7), (16, 32), (9, 13))
ORDERS = ("as they come", "backwards", "shuffled")
RUNS = ((0, 0), (1, 0), (1, 1), (2, 2), (3, 0), (3, 2))  # which tiles, in which order
SEEDS = (0, 1, 12345)
SIZE, PASSES = 48, 60


def identical(device: Device) -> str:
    """Run everything; AssertionError where bytes differ.  What was compared, in words."""
    count = 0
    for name, trial in TRIALS.items():
        for seed in SEEDS:
            problem = make(replace(trial, seed=seed))
            for method in ("refined", "swarm", "paper"):
                runs = RUNS if method != "paper" else [run for run in RUNS if run[1] == 0]
                found = [_arrays(device, problem, method, TILES[tile], order) for tile, order in runs]
                for (tile, order), other in zip(runs, found, strict=True):
                    assert other == found[0], (f"{method}, {name}, seed {seed}: tiles of {_size(TILES[tile])}, "
                                               f"{ORDERS[order]}, change the maps")
                count += len(found)
    for seed in SEEDS[:2]:
        for method in ("refined", "swarm"):
            whole = [_pipeline(method, seed, tile, order)
                     for tile, order in ((None, 0), (None, 0), ((48, 9), 1), ((17, 11), 2))]
            assert len(set(whole)) == 1, f"whole pipeline, {method}, seed {seed}: tiles change the maps"
            count += len(whole)
    words = (f"{count} runs compared byte by byte: {len(SEEDS)} seeds, tiles of {', '.join(map(_size, TILES))}; in "
             "order, backwards and shuffled; refined, swarm and (without its neighbours' pull) paper; without and with "
             "outliers; and the whole pipeline on pictures of a small scene: all alike")
    FOLDER.mkdir(parents=True, exist_ok=True)
    (FOLDER / "identical.json").write_text(json.dumps({"words": words}), "utf-8")
    return words


def _size(tile: tuple[int, int]) -> str:
    return f"{tile[0]} x {tile[1]}"


def _arrays(device: Device, problem: Problem, method: str, tile: tuple[int, int], order: int) -> bytes:
    """Of the maps of a problem."""
    source = PictureSource(device, problem)
    # Method paper without its neighbours' pull: with it a tile's halo is not endless (docs/paper.md).
    settings = SolveSettings(size=problem.trial.size, method=method, seed=problem.trial.seed, iterations=PASSES, c3=0.0)
    if method == "paper":
        swarm = PaperSwarm(device, source, settings, "one-lobe", tile)
        maps = result(swarm.solve())
        textures, thing = (maps.best, maps.more), swarm
        parts = [device.read(maps.best), device.read(maps.more)[..., :3]]
    else:
        solver = Solver(device, source, settings, tile)
        with ordered(order):
            found = result(solver.solve())
        textures, thing = (found.roughness, found.detail), solver  # type: ignore[assignment]
        parts = [device.read(t) for t in textures]
    made = b"".join(p.tobytes() for p in parts)
    for held in (*textures, thing, source):
        held.release()
    return hashlib.sha256(made).digest()


@contextmanager
def ordered(number: int) -> Iterator[None]:
    """Tiles in another order."""
    usual = observation_atlas.tiles

    def other(*arguments: Any) -> list[observation_atlas.Tile]:
        tiles = usual(*arguments)
        if number == 1:
            return tiles[::-1]
        return [tiles[i] for i in np.random.default_rng(7).permutation(len(tiles))] if number == 2 else tiles

    solver.tiles = model_ladder.tiles = material_solves.tiles = other
    try:
        yield
    finally:
        solver.tiles = model_ladder.tiles = material_solves.tiles = usual


def _pipeline(method: str, seed: int, tile: tuple[int, int] | None, order: int) -> bytes:
    """Of a whole solve, pictures with noise and a few outliers, on the GL thread."""
    usual = observation_atlas.TILE
    observation_atlas.TILE = tile or usual
    try:
        with ordered(order):
            shoot = _shoot()
            settings = SolveSettings(size=SIZE, method=method, seed=seed)
            maps = thread.run(lambda: pipeline.solve(shoot.scene, settings, shoot.read_image)).maps
    finally:
        observation_atlas.TILE = usual
    made = [maps.base_color, maps.roughness, maps.confidence, maps.error, maps.filled, maps.roughness_sigma]
    return hashlib.sha256(b"".join(a.tobytes() for a in made)).digest()


def _shoot() -> syn.Shoot:
    shoot = syn.shoot(syn.PATCHES, shoots.rig(2, 6), noise=0.01)
    rng = np.random.default_rng(3)
    images: Mapping[str, RadianceImage] = {
        name: replace(image, rgb=np.where(rng.random((*image.rgb.shape[:2], 1)) < 0.05, 2 * image.rgb, image.rgb))
        for name, image in shoot.images.items()}
    return replace(shoot, images=dict(images))
