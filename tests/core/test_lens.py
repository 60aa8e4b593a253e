"""The lens against the formulas in complex numbers, against another way to invert them, and there and back."""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from irpso_addon.core.lens import Lens

# A 24 mm lens and a 50 mm macro lens on 50 million pixels, as Metashape calibrated them for a museum.
WIDE = Lens(8688, 5792, 5998.2593, 5998.2593, 4349.3306, 2877.8766,
            (-0.10746863, 0.10306167, -0.01342632, 0.0), (0.00046072909, -0.00019654584))
MACRO = Lens(8688, 5792, 12665.26, 12665.26, 4329.5857, 2841.2543,
             (-0.050677068, 0.49650941, -1.7492542, 0.0), (-0.0005524033, -0.00027732833))
ODD = Lens(640, 480, 500.0, 520.0, 310.0, 250.0, (0.1, -0.02, 0.003, -0.0004), (0.001, -0.002), skew=3.0)
FISHEYE = Lens(4000, 4000, 1100.0, 1105.0, 2010.0, 1985.0, (-0.03, 0.004, -0.002, 0.0003), fisheye=True)
LENSES = [WIDE, MACRO, ODD, FISHEYE]
NAMES = ["wide", "macro", "odd", "fisheye"]


def flat_of(lens: Lens, x: float, y: float, z: float) -> complex:
    """Where the lens's own plane is met, before distortion."""
    if not lens.fisheye:
        return complex(x / z, y / z)
    return cmath.rect(math.acos(z / math.sqrt(x * x + y * y + z * z)), math.atan2(y, x))


def distorted(lens: Lens, z: complex) -> complex:
    """Brown's terms in one complex number: q = p2 + i p1 moves z by |z|^2 q + 2 z Re(z conj q)."""
    q = complex(lens.tangential[1], lens.tangential[0])
    radial = 1 + sum(k * abs(z) ** (2 * n + 2) for n, k in enumerate(lens.radial))
    return z * radial + abs(z) ** 2 * q + 2 * z * (z * q.conjugate()).real


def pixel(lens: Lens, z: complex) -> tuple[float, float]:
    return lens.cx + lens.fx * z.real + lens.skew * z.imag, lens.cy + lens.fy * z.imag


def corners(lens: Lens) -> np.ndarray:
    w, h = lens.width - 0.5, lens.height - 0.5
    return np.array([[0.5, 0.5], [w, 0.5], [0.5, h], [w, h]])


def directions(lens: Lens) -> np.ndarray:
    """(n, 3) over the whole picture."""
    u, v = np.meshgrid(np.linspace(0.5, lens.width - 0.5, 13), np.linspace(0.5, lens.height - 0.5, 9))
    return lens.rays(np.stack([u.ravel(), v.ravel()], -1))


@pytest.mark.parametrize("lens", LENSES, ids=NAMES)
def test_projects_as_the_formulas_say(lens):
    """To 1e-8 pixel, over the picture and at any distance."""
    rays = directions(lens)
    distances = np.geomspace(0.1, 1000, len(rays))[:, None]
    expected = [pixel(lens, distorted(lens, flat_of(lens, *point))) for point in rays]
    assert not np.isnan(rays).any()
    assert np.abs(lens.project(rays * distances) - expected).max() < 1e-8


@pytest.mark.parametrize("lens", LENSES, ids=NAMES)
def test_rays_of_corners_agree_with_another_inversion(lens):
    """Plain repetition z <- z - (d(z) - target), which knows no derivative; to 1e-7 pixel."""
    for u, v in corners(lens):
        y = (v - lens.cy) / lens.fy
        target = complex((u - lens.cx - lens.skew * y) / lens.fx, y)
        z = target
        for _ in range(2000):
            z -= 0.5 * (distorted(lens, z) - target)
        ray = lens.rays(np.array([u, v]))
        assert abs(flat_of(lens, *ray) - z) * lens.fx < 1e-7
        assert np.linalg.norm(ray) == pytest.approx(1)


def test_the_wide_lens_bends_its_corners():
    """By so much that a test in which distortion were left out, or p1 and p2 exchanged, could not pass."""
    rays = WIDE.rays(corners(WIDE))
    straight = Lens(8688, 5792, WIDE.fx, WIDE.fy, WIDE.cx, WIDE.cy)
    swapped = Lens(8688, 5792, WIDE.fx, WIDE.fy, WIDE.cx, WIDE.cy, WIDE.radial, WIDE.tangential[::-1])
    assert np.linalg.norm(straight.project(rays) - corners(WIDE), axis=-1).min() > 50
    assert np.linalg.norm(swapped.project(rays) - corners(WIDE), axis=-1).min() > 1


@pytest.mark.parametrize("lens", LENSES, ids=NAMES)
def test_there_and_back_on_every_pixel(lens):
    u, v = np.meshgrid(np.linspace(0.5, lens.width - 0.5, 97), np.linspace(0.5, lens.height - 0.5, 65))
    pixels = np.stack([u, v], -1)
    assert np.abs(lens.project(lens.rays(pixels)) - pixels).max() < 1e-8


small = st.floats(-0.5, 0.5)


@settings(max_examples=60, deadline=None)
@given(st.tuples(small, small, small, small), st.tuples(st.floats(-2e-3, 2e-3), st.floats(-2e-3, 2e-3)),
       st.floats(-5, 5), st.booleans())
def test_there_and_back_for_any_lens_up_to_where_it_turns(radial, tangential, skew, fisheye):
    lens = Lens(6000, 4000, 4000.0, 4100.0, 2990.0, 2015.0, radial, tangential, skew, fisheye)
    assume(lens.reach > 0.05)
    across, angle = np.meshgrid(np.linspace(0, 0.95 * min(lens.reach, 1.3), 20), np.linspace(0, 6.2, 16))
    sine, cosine = (np.sin(across), np.cos(across)) if fisheye else (across, np.ones_like(across))
    rays = np.stack([sine * np.cos(angle), sine * np.sin(angle), cosine], -1)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    pixels = lens.project(rays)
    back = lens.rays(pixels)
    assert np.abs(lens.project(back) - pixels).max() < 1e-6  # NaN fails too
    assert np.abs(back - rays).max() < 1e-6


@settings(max_examples=60, deadline=None)
@given(st.tuples(small, small, small, small))
def test_the_polynomial_rises_up_to_the_reach_and_not_beyond(radial):
    lens = Lens(100, 100, 100.0, 100.0, 50.0, 50.0, radial)

    def radius(r):
        return r + sum(k * r ** (2 * n + 3) for n, k in enumerate(radial))

    reach = min(lens.reach, 3.0)
    before = radius(np.linspace(0, reach, 2000))
    assert (np.diff(before) > -1e-9).all()
    if lens.reach < 3:
        turned = [reach * (1 + 1e-3), reach * (1 + 2e-3)]
        assert radius(turned[1]) < radius(turned[0])
        assert np.isnan(lens.project(np.array([turned[0], 0, 1.0]))).all()
        assert not np.isnan(lens.project(np.array([reach * (1 - 1e-9), 0, 1.0]))).any()


def test_nothing_is_seen_beyond_the_turn_or_behind():
    barrel = Lens(1000, 1000, 500.0, 500.0, 500.0, 500.0, (-0.3, 0.0, 0.0, 0.0))
    assert barrel.reach == pytest.approx(1 / math.sqrt(0.9), rel=1e-12)  # of r - 0.3 r^3
    assert np.isnan(barrel.rays(corners(barrel))).all()
    assert not np.isnan(barrel.rays(np.array([[500.0, 500.0], [500.0, 800.0]]))).any()
    points = np.array([[0.0, 0.0, -1.0], [0.1, 0.1, -1.0], [1.0, 0.0, 0.0], [np.nan, 0.0, 1.0]])
    assert np.isnan(ODD.project(points)).all()
    seen = FISHEYE.project(points)
    assert np.isnan(seen[3]).all() and not np.isnan(seen[1:3]).any()
    assert np.isnan(WIDE.rays(np.array([np.nan, 3.0]))).all()


def test_a_fisheye_without_terms_is_equidistant():
    lens = Lens(100, 100, 40.0, 40.0, 50.0, 50.0, fisheye=True)
    at = [[math.sin(angle), 0.0, math.cos(angle)] for angle in (0.0, 0.5, math.pi / 2, 2.5)]
    assert lens.project(np.array(at))[:, 0] == pytest.approx([50, 70, 50 + 20 * math.pi, 150])
    assert lens.rays(np.array([150.0, 50.0])) == pytest.approx(at[3])


@pytest.mark.parametrize("fisheye", [False, True])
@pytest.mark.parametrize("radial", [(1e9, -1e9, 1e9, -1e9), (-1e9, 0.0, 0.0, 0.0), (1e9, 1e9, 1e9, 1e9),
                                    (1e-320, 0.0, 0.0, 1e-300), (0.0, 0.0, 0.0, -1e-300)])
def test_no_numbers_are_too_wild(radial, fisheye):
    """Warnings are errors here."""
    lens = Lens(100, 100, 1e-3, 1e9, 1e9, -1e9, radial, (1e9, -1e9), 1e9, fisheye)
    lens.project(np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [np.inf, 1.0, 1.0], [0.0, 0.0, -1.0]]))
    lens.rays(np.array([[0.0, 0.0], [50.0, 50.0], [np.inf, 2.0]]))
    assert lens.rays(np.zeros((0, 2))).shape == (0, 3)
