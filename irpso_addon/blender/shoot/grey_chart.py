"""The six greys of a colour chart that one of the pictures shows: whether it is linear, and the lamps' power."""

from __future__ import annotations

from dataclasses import dataclass, replace

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
    UnusablePatch,
    Verdict,
    chart_curve,
    chart_response,
    chart_scale,
    chart_squares,
)
from .grey_card import LUMINANCE, colour_line
from .lit_picture import LitPicture, scale_power
from .view_pictures import ListedView, listed_views, named_view

CLEARER = 0.5  # of what a straight line leaves: a tone curve that leaves less is what the greys lie on


@dataclass(frozen=True)
class GreyChart:
    """What the user has clicked in a picture."""

    picture: str  # file of a view
    white: tuple[float, float]  # middle of the patch, pixels from the upper left corner of the upright picture
    black: tuple[float, float]


@dataclass(frozen=True)
class ChartFindings:
    """What a chart says."""

    response: str  # a line about the pictures' linearity
    messages: tuple[str, ...]  # of the power, and of patches that are left out
    linear: bool  # nothing is wrong with the response


def set_power_by_chart(context: bpy.types.Context, mesh: bpy.types.Object, chart: GreyChart) -> ChartFindings:
    """Checks the response; multiplies the power of every light of the views by one factor, unless it is non-linear.

    Where the chart lies is guessed as for a grey card.  Raises BadInput, and changes nothing then.
    """
    views = listed_views(context)
    shown = named_view(views, chart.picture)
    picture = LitPicture(context, mesh, shown)
    greys, means, left_out = _greys(picture, chart)
    lit = np.array([picture.irradiance(middle) for _, middle in greys])
    reflectances = np.array([grey for grey, _ in greys])
    dark = not (lit > 0).all()
    light = np.ones(len(lit)) if dark else lit.mean(1) / lit.mean()  # on the chart it may fall off
    response = chart_response(means.mean(1), reflectances * light, picture.name)
    curve = _curve(shown, means, reflectances * light)
    if response.verdict is Verdict.UNCLEAR and curve is not None and curve.residual < CLEARER * response.residual:
        response = replace(response, verdict=Verdict.CURVED)  # no straight line, but one curve all the same
    curved = response.verdict is Verdict.CURVED
    if curved or dark:
        why = "the picture is not linear" if curved else "no lamp of the scene lights the chart"
        lines = [f"{picture.name}: {why}; the lamps keep their power"]
    else:
        factors = chart_scale(means, reflectances[:, None] * lit / np.pi)
        factor = float(LUMINANCE @ factors)
        doubts = [*picture.whiter_line(factor), *picture.exposure_line(views)]
        scaled = scale_power(context, views, factor, f"the six greys in {picture.name}")
        lines = [*picture.messages, *scaled, *colour_line(factors, picture.name), *doubts]
    linear = response.verdict in (Verdict.LINEAR, Verdict.NEARLY)
    return ChartFindings(response.summary(picture.name, read_by_curve(shown.view), curve), (*left_out, *lines), linear)


def _curve(shown: ListedView, means: F64, reflectances: F64) -> GreyCurve | None:
    """The tone curve of the picture's file, unless one is undone already."""
    entry = shown.entry
    if entry.response != 1.0 or entry.shoulder != 1.0:
        return None
    return chart_curve((means * file_scale(shown.view)).mean(1), reflectances)


def _greys(picture: LitPicture, chart: GreyChart) -> tuple[list[tuple[float, F64]], F64, list[str]]:
    """Reflectance and middle (2,) of each grey that can be used; their colours (n, 3); lines about the others."""
    found, means, lines = [], [], []
    squares = chart_squares(chart.white, chart.black, picture.name)
    for square, grey, name in zip(squares, CHART_GREYS, GREY_NAMES, strict=True):
        try:
            patch, middle = picture.patch(tuple(square), f"{name} patch")
        except UnusablePatch as error:
            lines.append(f"{error}; it is left out")
            continue
        found.append((grey, middle))
        means.append(patch.mean - grey * picture.ambient)
    if not found:
        raise BadInput(lines[0])
    if not (np.array(means) > 0).all():
        raise BadInput(f"{picture.name}: the view's Ambient Light alone would make the chart brighter; correct it")
    return found, np.array(means), lines
