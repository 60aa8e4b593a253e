"""tools/head_experiment.py, tiny: runs only where the head scan lies beside the checkout (docs/head.md)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.one_python

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT.parent / "shared" / "data" / "head"

bpy = pytest.importorskip("bpy")


def test_a_folder_without_the_scan_is_named(tmp_path):
    from irpso_addon.core.errors import BadInput
    from tools import head_scene

    with pytest.raises(BadInput, match=r"holds no LeePerrySmith\.glb"):
        head_scene.build(tmp_path, cameras=1, lamps=1, pixels=32, samples=1)


@pytest.fixture(scope="module")
def record(tmp_path_factory):
    if not (FOLDER / "LeePerrySmith.glb").is_file():
        pytest.skip("the head scan is not there")
    from tools import head_experiment
    from tools.head_page import Options

    return head_experiment.run(Options(
        FOLDER, tmp_path_factory.mktemp("head"), size=64, pixels=72, samples=4, cameras=2, lamps=6, one_passes=300,
        many_passes=20))


def test_truth_worn_in_pixels_renders_as_the_truth(record):
    """The glue of the paper's setting: maps of the camera's pixels, rendered by Cycles, are what those pixels show."""
    from tools import head_experiment as experiment
    from tools import head_page as page
    from tools import head_scene as scan

    pixels = record.pixels
    scan.wear(scan.bare_maps(pixels.base, pixels.lobes), in_pixels=True)
    again = scan.render(record.options.out / "again.exr", experiment.CAMERA, experiment.ONE_LAMP)
    inside = pixels.shown & (pixels.fit[..., 3] > 0.999)
    shown = page.composite(again, pixels.fit, inside)
    assert shown.db > 35  # a pixel shows the mean over its square, the map its centre's value
    turned = scan.bare_maps(pixels.base[:, ::-1].copy(), pixels.lobes[:, ::-1].copy())
    scan.wear(turned, in_pixels=True)
    other = scan.render(record.options.out / "turned.exr", experiment.CAMERA, experiment.ONE_LAMP)
    assert page.composite(other, pixels.fit, inside).db < shown.db - 5


def test_one_image_is_explained_but_does_not_tell_the_lobes(record):
    from tools import head_page as page

    paper = next(result for result in record.one if result.method == "paper")
    fit = page.composite(paper.fit, record.pixels.fit, paper.view_seen)
    assert fit.mean < 0.03
    assert sum(page.figures(paper, paper.seen).fail) > 0.5  # of three numbers


def test_many_lights_tell_more(record):
    from tools import head_page as page

    paper, many = record.one[0], record.many[0]
    assert many.method == "refined"
    one_row, many_row = page.figures(paper, paper.seen), page.figures(many, many.seen)
    assert many_row.base > one_row.base + 2
    assert many_row.mae[0] < one_row.mae[0] and many_row.mae[1] < one_row.mae[1]
    relit = [page.composite(result.relit, record.pixels.relit, result.view_seen).db for result in (paper, many)]
    assert relit[1] > relit[0] + 3


def test_pictures_and_tables(record, tmp_path):
    from irpso_addon.core.images.image_file import open_image
    from tools import head_page as page

    page.draw(record, tmp_path)
    for name in ("head_one_image.jpg", "head_many_lights.jpg"):
        path = tmp_path / name
        assert 20_000 < path.stat().st_size < 400_000
        image = open_image(path)
        assert np.ptp(image.read(0, image.height)) > 0.8
    copy = tmp_path / "head.md"
    copy.write_text(page.PAGE.read_text(encoding="utf-8"), encoding="utf-8")
    page.write(record, copy)
    text = copy.read_text(encoding="utf-8")
    assert "72 x 72 pixels" in text and text.count("`refined`") >= 4
