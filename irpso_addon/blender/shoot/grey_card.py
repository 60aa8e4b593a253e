"""The lamps' power by a grey card of known reflectance that one of the pictures shows."""

from __future__ import annotations

from dataclasses import dataclass, replace

import bpy
import numpy as np

from ...core.data import F64
from ...core.shoot.grey_patch import patch_scale
from .lit_picture import LitPicture, scale_power
from .view_pictures import listed_views, named_view

# What channels weigh in the one factor: as in the luminance of Rec.709 (ITU-R BT.709-6, item 3.2).
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
COLOURED = 0.03  # ratio of the channels' factors from which the light's colour is told


@dataclass(frozen=True)
class GreyCard:
    """A square that the user has marked in a picture."""

    picture: str  # file of a view
    x: float  # pixels from the picture's upper left corner, as the picture is read: upright
    y: float
    side: float  # pixels
    reflectance: float  # 0 to 1


def set_power_by_grey_card(context: bpy.types.Context, mesh: bpy.types.Object, card: GreyCard) -> list[str]:
    """Multiplies the power of every light of the views by one factor, and marks the power as known; lines for the user.

    The card is a part of ``mesh`` where the square shows it; else it is taken to stand as far away as the mesh's middle
    and to face the camera.  Nothing shades it.  Raises BadInput, and changes nothing then.
    """
    views = listed_views(context)
    picture = LitPicture(context, mesh, named_view(views, card.picture))
    patch, middle = picture.patch((card.x, card.y, card.side))
    patch = replace(patch, mean=patch.mean - card.reflectance * picture.ambient)
    factors = patch_scale(patch, card.reflectance, picture.irradiance(middle), picture.name)
    factor = float(LUMINANCE @ factors)
    doubts = [*picture.whiter_line(factor), *picture.exposure_line(views)]
    lines = scale_power(context, views, factor, f"the grey card in {picture.name}")
    return picture.messages + lines + colour_line(factors, picture.name) + doubts


def colour_line(factors: F64, name: str) -> list[str]:
    """What factors (3,) of the channels in the picture ``name`` say of the light's colour; nothing where they agree."""
    if factors.max() / factors.min() <= 1 + COLOURED:
        return []
    red, green, blue = factors / float(LUMINANCE @ factors)
    return [f"{name}: colour of the light: the grey card needs red x {red:.3f}, green x {green:.3f}, blue x "
            f"{blue:.3f} of the lights' colour; set the lights' colour, or balance the pictures on the card"]
