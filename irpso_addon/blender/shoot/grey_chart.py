"""The six greys of a colour chart in a picture: whether it is linear, the views' tone curve, and the lamps' power."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import bpy
import numpy as np

from ...core.data import F64
from ...core.errors import BadInput
from ...core.images.reference_image import read_by_curve
from ...core.images.response import file_scale
from ...core.shoot.grey_patch import (
    CHART_GREYS,
    GREY_NAMES,
    GreyCurve,
    Response,
    UnevenPatch,
    UnusablePatch,
    Verdict,
    chart_curve,
    chart_response,
    chart_scale,
    chart_squares,
)
from .grey_card import LUMINANCE, colour_line
from .lit_picture import LitPicture, scale_power
from .view_pictures import ListedView, listed_views, view_or_file

CLEARER = 0.5  # of what a straight line leaves: a tone curve that leaves less is what the greys lie on
MOST_UNEVEN = 1  # patches that shine: where more do, the click was wrong


@dataclass(frozen=True)
class GreyChart:
    """What the user has clicked in a picture."""

    picture: str  # file of a view, or a file of no view
    white: tuple[float, float]  # middle of the patch, pixels from the upper left corner of the upright picture
    black: tuple[float, float]


@dataclass(frozen=True)
class ChartFindings:
    """What a chart says."""

    response: str  # a line about the pictures' linearity
    messages: tuple[str, ...]  # of the power, and of patches that are left out
    linear: bool  # nothing was wrong with the response
    scaled: bool  # the lamps have their power by it


@dataclass(frozen=True)
class _Greys:
    """The patches that can be used."""

    reflectances: F64  # (n,)
    middles: F64  # (n, 2) pixels from the upper left
    means: F64  # (n, 3) linear RGB, ambient light taken off
    left_out: tuple[str, ...]  # a line for each of the others


def read_chart(context: bpy.types.Context, mesh: bpy.types.Object, chart: GreyChart) -> ChartFindings:
    """Checks the response.  A tone curve on which the greys lie becomes that of all views whose files are of this kind.

    Then it multiplies the power of every light of the views by one factor, if the response is linear by now and the
    picture has a camera.  Where the chart lies is guessed as for a grey card; without a camera its light is unknown,
    and taken to be even.  Raises BadInput, and changes nothing then.
    """
    views = listed_views(context)
    shown = view_or_file(views, chart.picture)
    picture = LitPicture(context, mesh, shown)
    greys = _greys(picture, chart)
    lit = np.zeros_like(greys.means) if shown.entry is None else np.array(list(map(picture.irradiance, greys.middles)))
    dark = not (lit > 0).all()
    light = np.ones(len(lit)) if dark else lit.mean(1) / lit.mean()  # on the chart it may fall off
    response, curve = _response(shown, greys.means, greys.reflectances * light)
    curved, decoded = response.verdict is Verdict.CURVED, read_by_curve(shown.view)
    if curved and decoded and curve is not None:
        lines, scaled = _straight_now(context, mesh, chart, shown, curve)
    elif shown.entry is None or curved or dark:
        lines, scaled = (_unscaled(picture.name, shown.entry is None, curved),), False
    else:
        lines, scaled = _scaled(context, picture, views, greys, lit), True
    linear = response.verdict in (Verdict.LINEAR, Verdict.NEARLY)
    messages = tuple(dict.fromkeys((*greys.left_out, *lines)))  # the second look leaves out the same patches
    return ChartFindings(response.summary(picture.name, decoded, curve), messages, linear, scaled)


def _unscaled(name: str, no_camera: bool, curved: bool) -> str:
    why = ("the picture is not linear" if curved else "no lamp of the scene lights the chart" if not no_camera else
           "has no camera, so that the light on the chart is not known; it is taken to be even")
    return f"{name}: {why}; the lamps keep their power"


def _straight_now(
    context: bpy.types.Context, mesh: bpy.types.Object, chart: GreyChart, shown: ListedView, curve: GreyCurve,
) -> tuple[tuple[str, ...], bool]:
    """Gives the views the curve; what else the chart then says, and whether the lamps have their power by it.

    Raises BadInput, and the views have no curve then.
    """
    kind = shown.view.image.suffix.lower()
    entries = [entry for entry in context.scene.irpso.views if Path(entry.image).suffix.lower() == kind]
    before = [(entry.response, entry.shoulder) for entry in entries]
    for entry in entries:
        entry.response, entry.shoulder = curve.response, curve.shoulder
    try:
        if shown.entry is None:
            return (_unscaled(shown.name, True, False),), False
        again = read_chart(context, mesh, chart)
    except BadInput:
        for entry, (response, shoulder) in zip(entries, before, strict=True):
            entry.response, entry.shoulder = response, shoulder
        raise
    return again.messages, again.scaled


def _scaled(
    context: bpy.types.Context, picture: LitPicture, views: Sequence[ListedView], greys: _Greys, lit: F64,
) -> tuple[str, ...]:
    """Sets the lamps' power; lines for the user.  Raises BadInput, and changes nothing then."""
    factors = chart_scale(greys.means, greys.reflectances[:, None] * lit / np.pi)
    factor = float(LUMINANCE @ factors)
    doubts = [*picture.whiter_line(factor), *picture.exposure_line(views)]
    scaled = scale_power(context, views, factor, f"the six greys in {picture.name}")
    return (*picture.messages, *scaled, *colour_line(factors, picture.name), *doubts)


def _response(shown: ListedView, means: F64, reflectances: F64) -> tuple[Response, GreyCurve | None]:
    """By a straight line, and the tone curve of the picture's file, unless one is undone already.  Raises BadInput."""
    view, curve = shown.view, None
    own = view if shown.entry is None else shown.entry
    if own.response == 1.0 == own.shoulder:
        curve = chart_curve((means * file_scale(view)).mean(1), reflectances)
    response = chart_response(means.mean(1), reflectances, shown.name)
    if response.verdict is Verdict.UNCLEAR and curve is not None and curve.residual < CLEARER * response.residual:
        response = replace(response, verdict=Verdict.CURVED)  # no straight line, but one curve all the same
    return response, curve


def _greys(picture: LitPicture, chart: GreyChart) -> _Greys:
    """Raises BadInput where none can be used."""
    found, means, lines, uneven = [], [], [], 0
    squares = chart_squares(chart.white, chart.black, picture.name)
    for square, grey, name in zip(squares, CHART_GREYS, GREY_NAMES, strict=True):
        try:
            patch, middle = picture.patch(tuple(square), f"{name} patch")
        except (UnusablePatch, UnevenPatch) as error:
            uneven += isinstance(error, UnevenPatch)
            if uneven > MOST_UNEVEN:
                raise
            lines.append(f"{error}; it is left out")
            continue
        found.append((grey, *middle))
        means.append(patch.mean - grey * picture.ambient)
    if not found:
        raise BadInput(lines[0])
    if not (np.array(means) > 0).all():
        raise BadInput(f"{picture.name}: the view's Ambient Light alone would make the chart brighter; correct it")
    values = np.array(found)
    return _Greys(values[:, 0], values[:, 1:], np.array(means), tuple(lines))
