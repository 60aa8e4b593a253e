"""The demo's object: a proper unwrap, and paint that is what it says."""

from __future__ import annotations

import numpy as np

from irpso_addon.core.samples import vase

SIZE = 256


def corners(mesh: vase.QuadMesh) -> np.ndarray:
    return mesh.uvs.astype(np.float64)


def test_every_face_lies_in_the_square_and_keeps_its_side_up():
    uv = corners(vase.mesh())
    assert 0 < uv.min() and uv.max() < 1
    x, y = uv[..., 0], uv[..., 1]
    area = 0.5 * sum(x[:, i] * y[:, (i + 1) % 4] - x[:, (i + 1) % 4] * y[:, i] for i in range(4))
    assert (abs(area) > 1e-8).all()
    assert len({tuple(np.sign(area[part])) for part in (slice(0, 100), slice(5000, 5100))}) == 1


def test_no_two_faces_claim_a_texel():
    """Axis-aligned rectangles in UV, so texel centres can be counted exactly."""
    claims = np.zeros((SIZE, SIZE), int)
    for quad in corners(vase.mesh()):
        low, high = np.ceil(quad.min(0) * SIZE - 0.5).astype(int), np.ceil(quad.max(0) * SIZE - 0.5).astype(int)
        claims[low[1]:high[1], low[0]:high[0]] += 1
    assert claims.max() == 1
    assert claims.mean() > 0.85


def test_faces_look_outwards():
    """Newell normals of the body's outside point away from the axis."""
    mesh = vase.mesh()
    quads = mesh.vertices[mesh.quads].astype(np.float64)
    normal = np.cross(quads[:, 2] - quads[:, 0], quads[:, 3] - quads[:, 1])
    belly = (abs(quads[..., 2].mean(1)) < 0.1) & (np.arange(len(quads)) < vase.SEGMENTS * vase.RINGS)
    assert belly.sum() > 500
    outward = quads.mean(1) * (1, 1, 0)
    assert ((normal * outward).sum(1)[belly] > 0).all()


def test_paint_is_a_possible_material():
    base, rough = vase.truth(SIZE)
    assert base.shape == (SIZE, SIZE, 3) and rough.shape == (SIZE, SIZE)
    assert 0.0 < base.min() and base.max() < 0.9
    assert 0.15 < rough.min() and rough.max() < 0.9
    assert rough.std() > 0.1 and base.std() > 0.1  # something to find


def test_paint_meets_at_the_seam():
    """The body's left and right edge are one line on the vase."""
    base, _ = vase.truth(512)
    left, right = int(vase.BODY[0] * 512) + 1, int(vase.BODY[1] * 512) - 1
    rows = slice(int(vase.BODY[2] * 512) + 2, int(0.5 * 512))
    assert np.median(abs(base[rows, left] - base[rows, right])) < 0.02
