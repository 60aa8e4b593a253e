"""The whole pipeline on every kind of lamp, camera and view, and on what cannot be used: exact synthetic pictures."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from irpso_addon.core.data import Light, RadianceImage
from irpso_addon.core.errors import BadInput
from tests.support import synthetic as syn
from tests.support.shoots import SIZE, check, errors, rig, run, turned_away

# ---- what cannot be used, and what must be said


def test_views_that_see_nothing_are_skipped_and_named(patches):
    found = run(turned_away(patches, 2))
    names = [view.image.name for view in patches.scene.views]
    assert found.views_used == tuple(names[:-2])
    assert [name for name, _ in found.views_skipped] == names[-2:]
    assert all("no usable pixel" in why for _, why in found.views_skipped)
    assert np.median(errors(found, syn.PATCHES).rough) < 1e-5


def test_no_view_that_sees_anything_is_an_error(patches):
    with pytest.raises(BadInput, match=r"view_00\.exr, .* and 13 more: no usable pixel"):
        run(turned_away(patches, len(patches.scene.views)))


@pytest.mark.one_python
def test_masked_and_clipped_pixels_say_nothing(patches):
    """A stripe of each picture is nonsense: clipped in half of the views, masked in the others."""
    images = {}
    for n, (name, image) in enumerate(patches.images.items()):
        rgb, coverage, valid = image.rgb.copy(), image.coverage.copy(), image.valid.copy()
        start = (11 * n) % 60
        rgb[start:start + 8] = 7.0
        if n % 2:
            coverage[start:start + 8] = 0
        else:
            valid[start:start + 8] = False
        images[name] = RadianceImage(rgb, coverage, valid)
    found = errors(run(replace(patches, images=images)), syn.PATCHES)
    assert found.share > 0.99
    assert np.median(found.rough) < 1e-5
    assert np.quantile(found.rough, 0.95) < 0.005
    assert np.median(found.base) < 1e-4


def darkened(shoot: syn.Shoot, count: int) -> syn.Shoot:
    """The first ``count`` pictures are black."""
    images = {name: replace(image, rgb=0 * image.rgb) if n < count else image
              for n, (name, image) in enumerate(shoot.images.items())}
    return replace(shoot, images=images)


def test_a_black_picture_is_left_out_and_named(patches):
    found = run(darkened(patches, 1))
    assert found.views_skipped == (("view_00.exr", "it is black where it shows the object; replace the picture or "
                                                   "leave the view out"),)
    with pytest.raises(BadInput, match=r"view_00\.exr, .* and 13 more: it is black"):
        run(darkened(patches, len(patches.images)))


def test_a_mask_that_is_not_quite_white_is_one(patches):
    """As of an editor's soft brush, or of a JPEG."""
    def masked(coverage: float) -> syn.Shoot:
        return replace(patches, images={name: replace(image, coverage=coverage * image.coverage)
                                        for name, image in patches.images.items()})

    whole, soft = run(patches), run(masked(250 / 255))
    assert soft.texels["solved"] == whole.texels["solved"]
    with pytest.raises(BadInput, match=r"its mask or alpha is nowhere above 0\.60; use white"):
        run(masked(0.6))


def test_a_lamp_without_power_is_named(patches):
    views = list(patches.scene.views)
    dead = views[2].lights[0].name
    views = [replace(view, lights=tuple(
        replace(light, power=0 * light.power) if light.name == dead else light for light in view.lights))
        for view in views]
    found = run(replace(patches, scene=replace(patches.scene, views=tuple(views))))
    assert {why for _, why in found.views_skipped} == {"none of its lights has power; set their power"}


def test_faces_that_point_away_are_named(patches):
    mesh = patches.scene.mesh
    with pytest.raises(BadInput, match="no texel is lit and seen well in any view; check that its faces"):
        run(replace(patches, scene=replace(patches.scene, mesh=replace(mesh, normals=-mesh.normals))))


def test_lamps_that_are_much_too_strong_are_told_by_the_base_colour(patches):
    views = tuple(replace(view, lights=tuple(replace(light, power=100 * light.power) for light in view.lights))
                  for view in patches.scene.views)
    found = run(replace(patches, scene=replace(patches.scene, views=views)))
    assert any("darker than any common material; check the lamps' power" in line for line in found.warnings)


def ends_with_a_remedy(line: str) -> bool:
    """docs/style.md, rule 4: after the last semicolon a line states what to do."""
    return re.search(r"; (add|take|unwrap|move|set|check|increase|mend|expose) ", line) is not None


def test_overlapping_uvs_are_named(patches):
    mesh = patches.scene.mesh
    uvs = mesh.uvs.copy()
    uvs[: len(uvs) // 2] = uvs[len(uvs) // 2:]
    found = run(replace(patches, scene=replace(patches.scene, mesh=replace(mesh, uvs=uvs))))
    assert any("Subject" in w and "overlapping UVs" in w for w in found.warnings)
    assert all(ends_with_a_remedy(line) for line in found.warnings)


def test_uvs_outside_the_square_are_named(patches):
    mesh = patches.scene.mesh
    uvs = mesh.uvs.copy()
    uvs[: len(uvs) // 4, :, 0] += 1
    found = run(replace(patches, scene=replace(patches.scene, mesh=replace(mesh, uvs=uvs))))
    assert any("25.0 % of its faces are outside" in w for w in found.warnings)


def test_a_clean_solve_warns_of_nothing(solved):
    assert solved["refined"].warnings == ()


def test_what_no_view_sees_is_filled_and_said(patches):
    """The last quarter of the plane is turned away from all cameras: taken off the pictures, kept in the mesh."""
    mesh = patches.scene.mesh
    positions = mesh.positions.copy()
    hidden = len(positions) // 4
    positions[:hidden, :, 2] -= 5  # far below: the cameras' frames do not reach it
    positions[:hidden, :, 0] -= 40
    moved = replace(mesh, positions=positions)
    found = run(replace(patches, scene=replace(patches.scene, mesh=moved)))
    assert any("seen lit in no view" in w for w in found.warnings)
    assert all(ends_with_a_remedy(line) for line in found.warnings)
    assert found.texels["filled"] > 0.2 * found.texels["covered"]
    assert np.isfinite(found.maps.base_color).all()


@pytest.mark.one_python
def test_what_views_show_only_at_edges_is_not_called_unlit():
    """Lamps and cameras above an open plane light and see all of it; its border is wide in small pictures."""
    found = run(syn.shoot(syn.PATCHES, rig(), pixels=(24, 24), samples=2))
    covered = found.texels["covered"]
    assert found.texels["observed"] > 0.99 * covered and found.texels["filled"] > 0.05 * covered
    assert not any("lit in no view" in w for w in found.warnings)
    assert any("are seen only at edges of shadows or of the object" in w for w in found.warnings)
    assert all(ends_with_a_remedy(line) for line in found.warnings)


def test_pixels_per_texel_of_tiny_pictures_are_not_known():
    """No four pixels in a row are away from every edge; a warning of numpy's would fail the test."""
    found = run(syn.shoot(syn.PATCHES, rig(), pixels=(5, 5)), size=16)
    assert found.checks is not None and np.isnan(found.checks.pixels_per_texel)
    assert not any("coarser" in w for w in found.warnings)


def test_too_few_views_are_said(patches):
    few = replace(patches, scene=replace(patches.scene, views=patches.scene.views[:2]))
    found = run(few)
    assert any("fewer than 3 good observations" in w for w in found.warnings)
    assert np.isfinite(found.maps.roughness).all()
    assert (found.maps.confidence < 0.5).mean() > 0.9


# ---- every kind of lamp, camera and view


@pytest.mark.one_python
def test_lamps_of_colour():
    """All lamps (1, .6, .2): the base colour is what is under white light."""
    check(syn.shoot(syn.PATCHES, rig(power=(100.0, 60.0, 20.0))))


@pytest.mark.one_python
def test_lamps_of_many_colours():
    lamps = [replace(light, power=100 * np.roll([1.0, 0.6, 0.2], i)) for i, light in enumerate(syn.lamps(8))]
    check(syn.shoot(syn.PATCHES, [(c, [light]) for c in syn.cameras(2) for light in lamps]))


@pytest.mark.one_python
def test_lamps_of_pure_colours():
    """Red, green and blue lamps in turn: a view tells of one channel only."""
    lamps = [replace(light, power=100 * np.eye(3)[i % 3]) for i, light in enumerate(syn.lamps(12))]
    check(syn.shoot(syn.PATCHES, [(c, [light]) for c in syn.cameras(2) for light in lamps]), tail=0.02)


@pytest.mark.one_python
def test_two_lamps_in_one_view():
    lamps = syn.lamps(8)
    check(syn.shoot(syn.PATCHES, [(c, [lamps[i], lamps[(i + 3) % 8]]) for c in syn.cameras(2) for i in range(8)]))


@pytest.mark.one_python
def test_two_lamps_of_different_colour_in_one_view():
    lamps = [replace(light, power=100 * np.roll([1.0, 0.5, 0.2], i)) for i, light in enumerate(syn.lamps(8))]
    check(syn.shoot(syn.PATCHES, [(c, [lamps[i], lamps[(i + 4) % 8]]) for c in syn.cameras(2) for i in range(8)]))


def test_views_with_one_lamp_and_with_three():
    lamps = syn.lamps(8)
    views = [(c, lamps[i:i + 1] if i % 2 else [lamps[i], lamps[i - 3], lamps[i - 5]])
             for c in syn.cameras(2) for i in range(8)]
    check(syn.shoot(syn.PATCHES, views))


def of_kind(kind: str, count: int, **settings: Any) -> list[Light]:
    return [syn.lamp(light.matrix[:3, 3], kind=kind, name=light.name, **settings) for light in syn.lamps(count)]


@pytest.mark.parametrize(("kind", "settings"), [
    ("SUN", {"power": (3.0, 2.5, 2.0)}),
    ("SPOT", {"spot_angle": 1.2, "spot_blend": 0.5}),
    ("POINT", {"radius": 0.01}),
])
def test_lamps_without_a_size(kind, settings):
    """A radius of 1 cm at 3 m is 0.2 degrees: much narrower than any lobe here."""
    loose = 5e-4 if "radius" in settings else 1e-5
    check(syn.shoot(syn.PATCHES, [(c, [lamp]) for c in syn.cameras(2) for lamp in of_kind(kind, 8, **settings)],
                    (40, 40)), size=40,
          rough=loose, base=10 * loose)


@pytest.mark.parametrize(("kind", "settings"), [
    ("AREA", {"size": (0.4, 0.4)}),
    ("AREA", {"shape": "DISK", "size": (0.3, 0.3)}),
    ("POINT", {"radius": 0.15}),
    ("SUN", {"radius": np.radians(3)}),
])
def test_lamps_with_a_size(kind, settings):
    """The mean of the lobe over the emitter by the two-point rule: 0.0008 of roughness; one point has 0.003."""
    lamps = of_kind(kind, 8, **settings)
    check(syn.shoot(syn.PATCHES, [(c, [lamp]) for c in syn.cameras(2) for lamp in lamps], (32, 32)), size=32,
          rough=1.5e-3, base=5e-4, tail=0.006)


@pytest.mark.one_python
def test_orthographic_cameras():
    cameras = syn.cameras(2, width=2.3)
    check(syn.shoot(syn.PATCHES, [(c, [light]) for c in cameras for light in syn.lamps(8)]))


@pytest.mark.one_python
def test_pictures_that_are_not_square():
    cameras = syn.cameras(2, aspect=1.5, degrees=40.0, shift=(0.1, -0.05))
    check(syn.shoot(syn.PATCHES, [(c, [light]) for c in cameras for light in syn.lamps(8)], (102, 68)))


@pytest.mark.one_python
def test_cameras_with_pictures_of_two_sizes():
    """The same camera, photographed at two resolutions."""
    camera = syn.cameras(1)[0]
    small = syn.shoot(syn.PATCHES, [(camera, [light]) for light in syn.lamps(8)], (60, 60))
    large = syn.shoot(syn.PATCHES, [(camera, [light]) for light in syn.lamps(8)[:4]], (90, 90))
    views = [replace(view, image=Path("large_" + view.image.name)) for view in large.scene.views]
    images = small.images | {"large_" + name: image for name, image in large.images.items()}
    both = syn.Shoot(replace(small.scene, views=small.scene.views + tuple(views)), images, syn.PATCHES)
    check(both)


@pytest.mark.one_python
def test_a_single_camera():
    check(syn.shoot(syn.PATCHES, rig(cameras=1)))


@pytest.mark.one_python
def test_a_pixel_is_the_mean_over_its_square():
    """Pictures of 25 samples a pixel on rolling normals: half the error of taking a pixel for its centre."""
    shoot = syn.shoot(syn.PATCHES, rig(), (48, 48), samples=5)
    aware = errors(run(shoot), syn.PATCHES)
    point = errors(run(replace(shoot, scene=replace(shoot.scene, pixel_filter=0.01))), syn.PATCHES)
    assert aware.share > 0.9  # less the rim, which only edge pixels show
    assert np.median(aware.rough) < 0.0012
    assert np.quantile(aware.rough, 0.9) < 0.007
    assert np.median(aware.base) < 8e-4
    assert np.median(aware.rough) < 0.65 * np.median(point.rough)


TURN = np.linalg.qr(np.array([[0.9, 0.3, -0.2], [-0.4, 0.8, 0.5], [0.3, -0.35, 0.9]]))[0]


@pytest.mark.one_python
@pytest.mark.parametrize("orthographic", [False, True])
@pytest.mark.parametrize(("scale", "offset"), [(1, (3, -2, 5)), (1e-3, (0, 0, 0)), (1e3, (0, 0, 0)),
                                               (1, (800, -400, 500))])
def test_place_and_size_of_the_scene_do_not_matter(scale, offset, orthographic):
    """A millimetre, a kilometre, a kilometre away (where float32 has 6e-5 m left: 1e-4 of roughness)."""
    cameras = syn.cameras(2, width=2.3 if orthographic else None)
    shoot = syn.shoot(syn.PATCHES, [(c, [light]) for c in cameras for light in syn.lamps(8)])
    if orthographic:  # metres per image: part of the projection
        projection = np.diag([1 / scale, 1 / scale, 1, 1])
        views = tuple(replace(v, camera=replace(v.camera, projection=v.camera.projection @ projection))
                      for v in shoot.scene.views)
        shoot = replace(shoot, scene=replace(shoot.scene, views=views))
    check(syn.moved(shoot, scale, TURN * np.sign(np.linalg.det(TURN)), offset), rough=2e-4)


@pytest.mark.one_python
def test_more_views_than_the_kernel_keeps():
    check(syn.shoot(syn.PATCHES, rig(cameras=6, lamps=13), (48, 48)), size=48)


@pytest.mark.one_python
def test_shadows_do_not_darken_the_paint():
    """Two boxes over the plane: what one lamp does not reach, others show.  Under them nothing may be seen."""
    blocks = [((-0.5, -0.4, 0.2), (-0.1, 0.3, 0.5)), ((0.35, -0.6, 0.05), (0.55, 0.7, 0.25))]
    shoot = syn.shoot(syn.PATCHES, rig(cameras=4, lamps=8), blocks=blocks)
    dark = np.mean([(image.rgb[image.coverage > 0] == 0).mean() for image in shoot.images.values()])
    assert dark > 0.05
    off = errors(run(shoot), syn.PATCHES)
    assert off.share > 0.9
    assert np.median(off.rough) < 1e-5
    assert np.quantile(off.rough, 0.95) < 0.02
    assert np.median(off.base) < 1e-4
    assert np.quantile(off.base, 0.95) < 0.03


@pytest.mark.one_python
def test_one_view_per_camera_under_many_lamps():
    """All lamps stay on and only the camera moves, as in a room: highlights wander over the surface none the less."""
    lamps = syn.lamps(4)
    found = run(syn.shoot(syn.PATCHES, [(camera, lamps) for camera in syn.cameras(10)], (56, 56)))
    assert found.model == {"Paint": "one-lobe"}
    off = errors(found, syn.PATCHES)
    assert np.median(off.rough) < 0.01
    assert np.median(off.base) < 0.003


@pytest.mark.one_python
def test_slots_of_one_material_decide_together():
    """A material may sit in two slots.  A corner that shows no highlight does not take it from the rest."""
    mesh = syn.plane_mesh(lambda u, v: (u > 0.9) & (v > 0.9), ("Paint", "Paint"))
    dull_corner = replace(syn.PATCHES, lobe=lambda u, v: 1.0 - ((np.asarray(u) > 0.9) & (np.asarray(v) > 0.9)))
    found = run(syn.shoot(dull_corner, rig(), mesh=mesh))
    assert found.model == {"Paint": "one-lobe"}
    assert np.median(errors(found, syn.PATCHES).rough) < 1e-5


@pytest.mark.one_python
def test_more_material_slots_than_an_int_has_bits():
    """Forty materials, the right half of them dull."""
    names = tuple(f"Material {i}" for i in range(40))
    mesh = syn.plane_mesh(lambda u, v: np.minimum((u * 40).astype(int), 39), names)
    mixed = replace(syn.PATCHES, lobe=lambda u, v: (np.asarray(u) < 0.5).astype(float))
    found = run(syn.shoot(mixed, rig(), mesh=mesh))
    # The mesh has fewer columns of cells than materials: some slots have no face.
    assert {found.model[name] for name in names[4:18] if name in found.model} == {"one-lobe"}
    assert {found.model[name] for name in names[22:36] if name in found.model} == {"lambert"}
    at = (np.arange(SIZE) + 0.5) / SIZE
    base = np.abs(found.maps.base_color - mixed.base(*np.meshgrid(at, at))).max(-1)
    assert np.median(base[4:-4, 6:SIZE // 2 - 3]) < 1e-4
    assert np.median(base[4:-4, SIZE // 2 + 3:-6]) < 1e-4


@pytest.mark.one_python
def test_a_material_of_no_colour_and_a_mirror_like_one():
    """Black, white, smooth and fully rough quarters."""
    hard = syn.Truth(base=syn.quarters([(0.01, 0.01, 0.01), (0.95, 0.95, 0.95), (0.9, 0.1, 0.02), (0.3, 0.3, 0.3)]),
                     roughness=syn.quarters([0.5, 0.35, 0.85, 0.2]))
    found = run(syn.shoot(hard, rig(cameras=2, lamps=12)))
    off = errors(found, hard)
    assert np.median(off.rough) < 1e-4
    assert np.median(off.base) < 5e-4
    assert np.isfinite(found.maps.base_color).all()


@pytest.mark.one_python
def test_a_shadow_in_a_picture_that_the_scene_does_not_explain(patches):
    """A dark band over one view (something unmodelled): the robust base colour stays within 0.02."""
    images = dict(patches.images)
    name = patches.scene.views[4].image.name
    rgb = images[name].rgb.copy()
    rgb[20:50] *= 0.3
    images[name] = replace(images[name], rgb=rgb)
    off = errors(run(replace(patches, images=images)), syn.PATCHES)
    assert np.median(off.base) < 0.005
    assert np.quantile(off.base, 0.9) < 0.03


# ---- creases


@pytest.mark.one_python
def test_pixels_at_creases_sharpen_little(monkeypatch):
    """Slopes of the shading normal that change sign within a pixel or two: 0.0029 here, 0.0041 if all count alike."""

    def roofs() -> np.ndarray:
        slope = np.where(np.arange(syn.CELLS + 1) // 4 % 2 == 0, 0.3, -0.3)[:, None].repeat(syn.CELLS + 1, 1)
        normal = np.stack([slope, 0 * slope, np.ones_like(slope)], -1)
        return (normal / np.linalg.norm(normal, axis=-1, keepdims=True)).astype(np.float32)

    monkeypatch.setattr(syn, "_corner_normals", roofs)
    truth = syn.Truth(
        base=lambda u, v: np.stack([0.4 + 0.2 * np.sin(9 * u + 3 * v), 0.4 + 0.2 * np.cos(8 * v),
                                    0.3 + 0.1 * np.sin(7 * u)], -1),
        roughness=lambda u, _: np.full_like(np.asarray(u, float), 0.5))
    made = syn.shoot(truth, rig(6, 4), (36, 36), samples=6)
    off = errors(run(made, size=48, model="one-lobe", registration="given", indirect="off"), truth, border=0.0)
    assert off.base.mean() < 0.0035
