"""From drawn views to the figures of a check before a solve: `ShootMeasure`, one view at a time."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..data import F64, Light, SceneData, View
from ..phrases import percent
from ..projection import pixels_of
from .check_tile import tile
from .drawn_view import DrawnView
from .edge_shift import EdgeMatch, EdgeShift, has_outline, together
from .epipolar import Side, compared
from .highlights import (
    LampVotes,
    Peak,
    SeenHighlight,
    axes_of,
    distance_of,
    highlight_of,
    lamp_votes,
    peak_of,
    towards,
)
from .shoot_check import INSIDE, CheckPicture, LampFigures, PairFigures, ShootCheck, ViewFigures, findings

TOGETHER = 0.02  # of the distance: a lamp that keeps its place beside the camera so well goes with it
GRID = 0.01  # of the distance: error of places that no statistics shows
LEAST_VIEWS = 3  # that say where a lamp stands
MATT = 20.0  # degrees of half vector from which on a base colour is looked at
PLACES = 2000  # on the mesh that a camera is asked for
FEW = 50  # pixels
HIDDEN = 0.03  # share of the object's pixels that are clipped, from which on they are not highlights alone
UP = np.array([0.0, 0.0, 1.0])


class ShootMeasure:
    """Collects views; keeps little of each."""

    def __init__(self, scene: SceneData, chosen: Sequence[View]) -> None:
        """``chosen``: the views that are to be added."""
        corners = scene.mesh.positions.reshape(-1, 3).astype(np.float64)
        self.scene, self.middle = scene, (corners.min(0) + corners.max(0)) / 2
        self.on_camera = goes_with_camera(chosen, self.middle)
        self.views: list[ViewFigures] = []
        self.pictures: list[CheckPicture] = []
        self.pairs: list[PairFigures] = []
        self.votes: dict[str, list[LampVotes]] = {}  # by lamp
        self.lights: dict[str, Light] = {}
        self._unclear: list[EdgeMatch] = []  # of views whose edges were not found
        self.places = places_on(scene.mesh.positions.astype(np.float64), PLACES)

    def add(self, drawn: DrawnView, match: EdgeMatch, shift: EdgeShift | None, outline: float | None) -> None:
        """One more view; the ``shift`` by its edges, and how far outlines lie apart after it, in checked pixels."""
        if shift is None and drawn.covered.any():
            self._unclear.append(match)
        votes = [self._voted(drawn, n) for n in range(len(drawn.view.lights))]
        highlight = _clearest([highlight_of(v, drawn.size) for v in votes if len(v.at)])
        if clipped_share(drawn) > HIDDEN:  # the brightest places are not known
            highlight = None if highlight is None else replace(highlight, seen=None)
        else:
            self._keep(drawn.view, votes)
        figures = replace(_figures(drawn, votes, shift, highlight),
                          outline=None if outline is None else outline * drawn.reduction)
        self.views.append(figures)
        self.pictures.append(CheckPicture(tile(drawn, highlight), lines_of(figures)))

    def compare(self, one: Side, other: Side) -> None:
        """One more pair of views."""
        self.pairs.append(compared(one, other))

    def _voted(self, drawn: DrawnView, number: int) -> LampVotes:
        light = drawn.view.lights[number]
        up = drawn.view.camera.world_to_camera[1, :3] if self.on_camera else UP
        return lamp_votes(drawn, number, axes_of(light, self.middle, up), self.middle)

    def _keep(self, view: View, votes: Sequence[LampVotes]) -> None:
        for light, found in zip(view.lights, votes, strict=True):
            if not len(found.at):
                continue
            key = "" if self.on_camera else light.name
            self.votes.setdefault(key, []).append(found)
            self.lights.setdefault(key, light)

    def check(self) -> ShootCheck:
        """The whole check, with what is wrong."""
        views = self.scene.views
        found = ShootCheck(self.scene.mesh.name, tuple(self.views), len(views), self._outside(), tuple(self._lamps()),
                           pictures=tuple(self.pictures), pairs=tuple(self.pairs), common=self._common_shift())
        return replace(found, findings=findings(found))

    def _common_shift(self) -> float | None:
        """Checked pixels by which all views whose edges are unclear lie beside their drawings together."""
        found = together(self._unclear)
        return None if found is None else float(np.hypot(*found.shift))

    def _outside(self) -> tuple[str, ...]:
        """Of all views, those that do not show the mesh."""
        names, known = [], dict[str, float]()
        for view in self.scene.views:
            if view.camera.name not in known:
                at = pixels_of(view.camera, self.places, (1, 1))  # NaN is not inside
                known[view.camera.name] = float(np.mean(((at >= 0) & (at <= 1)).all(-1)))
            if known[view.camera.name] < INSIDE:
                names.append(view.image.name)
        return tuple(names)

    def _lamps(self) -> list[LampFigures]:
        lamps = []
        for key, votes in self.votes.items():
            found, light = _place(votes), self.lights[key]
            if found is None:
                continue
            peak, error = found
            distance = float(np.median([v.distance for v in votes]))
            x, y, z = (votes[0].axes.T @ peak.place * distance).tolist()
            names = [name for view in self.views for name in view.lights]
            lamps.append(LampFigures(
                key or _common(names), len(votes), self.on_camera, light.kind == "SUN", distance, peak.place, error,
                (0.0, 0.0, 0.0) if self.on_camera else (x, y, z)))
        return lamps


def places_on(triangles: F64, count: int) -> F64:
    """(count, 3) places on triangles (T, 3, 3), spread by area; always the same ones."""
    rng = np.random.default_rng(0)
    across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    size = np.linalg.norm(across, axis=1) + 1e-30
    chosen = triangles[rng.choice(len(triangles), count, p=size / size.sum())]
    return np.asarray((rng.dirichlet((1.0, 1.0, 1.0), count)[..., None] * chosen).sum(1))


def goes_with_camera(views: Sequence[View], middle: F64) -> bool:
    """Whether each view has one lamp, which stands at the same place beside each camera."""
    if len({view.camera.name for view in views}) < 2 or any(len(view.lights) != 1 for view in views):
        return False
    lights = [view.lights[0] for view in views]
    if any(light.kind == "SUN" for light in lights):
        return False
    places = np.array([(view.camera.world_to_camera @ light.matrix[:, 3])[:3]
                       for view, light in zip(views, lights, strict=True)])
    world = np.array([light.matrix[:3, 3] for light in lights])
    near = TOGETHER * min(distance_of(light, middle) for light in lights)
    return bool(np.ptp(places, axis=0).max() < near <= np.ptp(world, axis=0).max())


def _place(votes: Sequence[LampVotes]) -> tuple[Peak, float] | None:
    """Where highlights of all views say that a lamp stands, and the error by what two halves of the views say."""
    peak = peak_of(votes) if len(votes) >= LEAST_VIEWS else None
    halves = [peak_of(votes[n::2]) for n in (0, 1)]
    if peak is None or halves[0] is None or halves[1] is None:
        return None
    apart = np.hypot(*np.subtract(halves[0].place, halves[1].place))
    return peak, float(np.hypot(apart / 2, GRID))


def _clearest(found: Sequence[SeenHighlight]) -> SeenHighlight | None:
    """Of the view's lamps: one that is seen, near its place."""
    return min(found, key=lambda h: np.inf if h.seen is None else h.pixels, default=None)


def _figures(
    drawn: DrawnView, votes: Sequence[LampVotes], shift: EdgeShift | None, highlight: SeenHighlight | None,
) -> ViewFigures:
    view, shown = drawn.view, drawn.shown
    n = drawn.reduction
    white = 2.0**view.exposure * view.gain
    median = float(np.median(drawn.brightness[shown])) if shown.any() else 0.0
    colours = _base_colours(votes)
    lit = np.max(drawn.lit, axis=0)[drawn.covered] if drawn.lit and drawn.covered.any() else np.zeros(1)
    return ViewFigures(
        view.image.name, tuple(light.name for light in view.lights), n, bool(drawn.covered.any()),
        None if shift is None else (shift.shift[0] * n, shift.shift[1] * n), shift is not None and shift.outlined,
        clipped_share(drawn), median * white if drawn.white else None, float(np.mean(lit > 0.5)),
        float(np.median(colours)), float(np.quantile(colours, 0.98)),
        None if highlight is None or highlight.seen is None else (highlight.pixels * n, highlight.degrees),
        view.mask is not None, float(np.mean(shown[drawn.covered])) if drawn.covered.any() else 0.0, shot=drawn.shot,
        exposure=view.exposure, backs=_backs(drawn))


def _backs(drawn: DrawnView) -> float:
    """Share of the drawn pixels whose normals look away from the camera."""
    P, N = (values[drawn.covered].astype(np.float64) for values in (drawn.position, drawn.normal))
    return float(np.mean((towards(drawn.view.camera, P) * N).sum(-1) < 0)) if len(P) else 0.0


def clipped_share(drawn: DrawnView) -> float:
    """Of the object's pixels: the file's own where it says what is object.

    Elsewhere a pixel of the reduced picture counts as clipped where any of the file's below it is: those that are
    clipped in the whole file are the most that the object can have.
    """
    if has_outline(drawn.image.coverage):
        return drawn.image.clipped_share
    if not drawn.shown.any():
        return 0.0
    most = drawn.image.clipped_share * drawn.shown.size / np.count_nonzero(drawn.shown)
    return min(float(most), float(np.mean(~drawn.image.valid[drawn.shown])))


def _base_colours(votes: Sequence[LampVotes]) -> F64:
    """(N,) of pixels away from highlights, where there are enough of them; NaN where nothing is lit."""
    none = np.zeros(0)
    for least in (MATT, 0.0):
        values = np.concatenate([none, *(v.value[v.degrees >= least] for v in votes)])
        if len(values) >= FEW:
            return np.asarray(np.pi * values)
    return np.full(1, np.nan)


def _common(names: Sequence[str]) -> str:
    """What lamps of one kind are called together: the words with which all their names begin."""
    first, last = min(names).split(" "), max(names).split(" ")
    words = [a for a, b in itertools.takewhile(lambda pair: pair[0] == pair[1], zip(first, last, strict=False))]
    return " ".join(words) or names[0]


def lines_of(view: ViewFigures) -> tuple[str, ...]:
    """A view's figures, below its picture."""
    edges = "edges not found" if view.shift is None else (
        f"edges {view.pixels:.2f} px off ({view.shift[0]:+.1f}, {view.shift[1]:+.1f})")
    if view.outline is not None:
        edges += f", outline {view.outline:.1f} px"
    glint = "no clear highlight" if view.highlight is None else (
        f"highlight {view.highlight[1]:.1f} deg, {view.highlight[0]:.0f} px off")
    bright = "" if view.brightness is None else f", median {percent(view.brightness)} of white"
    colour = "" if np.isnan(view.albedo) else f"; base colour {view.albedo:.2f}"
    return (view.view if len(view.view) < 48 else f"{view.view[:44]}...", edges, glint + colour,
            f"clipped {percent(view.clipped, 1)}{bright}, lit {percent(view.lit)}")
