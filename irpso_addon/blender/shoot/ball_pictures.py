"""Chrome balls in the pictures of a camera: their outlines, and the rays that they reflect to the lamps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import bpy
import numpy as np

from ...core.data import F64
from ...core.errors import BadInput
from ...core.lens import Lens
from ...core.phrases import percent
from ...core.projection import lens_axes, lens_for
from ...core.shoot.ball_highlight import Ray, find_highlight, reflected_ray
from ...core.shoot.chrome_ball import HOW, Ball, Circle, confirmed_ball, find_ball
from .view_pictures import ListedView, read_picture


@dataclass(frozen=True)
class ChromeBall:
    """A ball that all pictures of a camera show in the same place."""

    camera: bpy.types.Object
    circle: Circle | None  # roughly around it, pixels from the upper left corner; None: it is to be found
    radius: float  # metres
    drawn: bool = False  # by hand: the circle is its outline, unless edges that agree say so more exactly


@dataclass(frozen=True)
class FoundBall:
    """Its outline."""

    name: str  # for messages
    camera: bpy.types.Object
    radius: float  # metres
    lens: Lens  # for the camera's pictures as they are read
    ball: Ball
    as_drawn: bool = False  # the user's circle: the edges in the pictures do not agree with it

    @property
    def circle(self) -> Circle:
        """Nearest to the outline, pixels."""
        return self.ball.circle(self.lens)

    @property
    def line(self) -> str:
        """For the user."""
        x, y, radius = self.circle
        away = float(np.linalg.norm(self.ball.centre(self.radius)))
        at = (f"{self.name}: at ({x:.1f}, {y:.1f}), radius {radius:.1f} pixels, so {away:.3g} m from the camera if its "
              f"own radius is {1000 * self.radius:g} mm")
        if self.as_drawn:
            return f"{at}, as drawn; the picture shows no outline that agrees with it"
        return f"{at}; {percent(self.ball.support)} of its outline shows, {self.ball.residual:.2f} px from a sphere's"


def find_balls(views: Sequence[ListedView], balls: Sequence[ChromeBall]) -> list[FoundBall]:
    """The outline of each, in the mean of its camera's pictures.  Raises BadInput, naming the ball."""
    if not balls:
        raise BadInput("no chrome ball is listed; add one and choose its camera")
    means: dict[bpy.types.Object, tuple[F64, Lens]] = {}
    found: list[FoundBall] = []
    for number, ball in enumerate(balls, 1):
        name = f"ball {number} (camera '{ball.camera.name}')"
        if not (np.isfinite(ball.radius) and ball.radius > 0):
            raise BadInput(f"{name}: its radius is {1000 * ball.radius:g} mm; enter the radius that you measured")
        if ball.camera not in means:
            means[ball.camera] = _mean(name, pictures_of(views, ball.camera))
        image, lens = means[ball.camera]
        seen = FoundBall(name, ball.camera, ball.radius, lens, *_outline(image, lens, ball, name))
        _refuse_twice(seen, found)
        found.append(seen)
    return found


def _outline(image: F64, lens: Lens, ball: ChromeBall, name: str) -> tuple[Ball, bool]:
    """And whether it is as drawn.  Raises BadInput."""
    if ball.circle is None or not ball.drawn:
        return find_ball(image, lens, ball.circle, name), False
    found, agrees = confirmed_ball(image, lens, ball.circle, name)
    return found, not agrees


def pictures_of(views: Sequence[ListedView], camera: bpy.types.Object) -> list[ListedView]:
    """The views of a camera."""
    return [view for view in views if view.entry.camera == camera]


def world_rays(view: ListedView, balls: Sequence[FoundBall]) -> list[Ray]:
    """From each of the balls, of this view's camera, to the one lamp that lit the picture; in the world.

    Raises BadInput, naming picture and ball.
    """
    rgb, _ = read_picture(view.view)
    axes, place = lens_axes(view.view.camera), view.view.camera.position
    rays = []
    for found in balls:
        name = f"{view.name}: {found.name}"
        pixel = find_highlight(rgb, found.lens, found.ball, name)
        ray = reflected_ray(found.ball, found.lens, pixel, found.radius, name)
        rays.append(Ray(place + ray.origin @ axes[:3, :3], ray.direction @ axes[:3, :3]))
    return rays


def _mean(name: str, views: Sequence[ListedView]) -> tuple[F64, Lens]:
    """Brightness (h, w) in the mean of pictures of one camera, row 0 at the top, and its lens for them."""
    if not views:
        raise BadInput(f"{name}: no view in use has this camera; add its pictures as views, or choose the camera that "
                       "shows the ball")
    camera = views[0].view.camera
    if views[0].entry.camera.data.type != "PERSP":
        raise BadInput(f"{name}: the camera is not perspective; choose one that is")
    total: F64 | None = None
    for view in views:
        bright = read_picture(view.view)[0].mean(-1, dtype=np.float64)
        if total is not None and total.shape != bright.shape:
            raise BadInput(f"{view.name}: is {bright.shape[1]} x {bright.shape[0]} pixels, {views[0].name} "
                           f"{total.shape[1]} x {total.shape[0]}; give all pictures of camera '{camera.name}' one size")
        total = bright if total is None else total + bright
    assert total is not None
    return total / len(views), lens_for(camera, (total.shape[1], total.shape[0]))


def _refuse_twice(seen: FoundBall, before: Sequence[FoundBall]) -> None:
    """Raises BadInput where the ball was found already."""
    x, y, radius = seen.circle
    for other in before:
        if other.camera == seen.camera and np.hypot(x - other.circle[0], y - other.circle[1]) < radius:
            raise BadInput(f"{seen.name}: is found where {other.name} is; give a circle around each ball {HOW}")
