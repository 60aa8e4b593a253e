"""RAW files: DNGs written here by the specification, beside the same in float64 and LibRaw's own development."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from irpso_addon.core.errors import BadInput
from irpso_addon.core.images import decoder_pool, oiio_reader, raw_reader
from irpso_addon.core.images.image_file import open_image
from irpso_addon.core.images.reference_image import read_reference, with_one_white_balance
from tests.support.dng_files import BAYER, COLOUR_MATRIX, XTRANS, Shot, save_dng, tiff
from tests.support.picture_files import save, view
from tests.support.random_pictures import RNG

pytest.importorskip("OpenImageIO")
rawpy = pytest.importorskip("rawpy")
ROOT = Path(__file__).parents[2]
# IEC 61966-2-1: linear Rec.709 to XYZ of D65
TO_XYZ = np.array([[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750],
                   [0.0193339, 0.1191920, 0.9503041]])


def samples(low: int = 1000, high: int = 14000, size: tuple[int, int] = (40, 60)) -> np.ndarray:
    return RNG.integers(low, high, size).astype(np.uint16)


def camera_values(raw: np.ndarray, shot: Shot) -> np.ndarray:
    """(h / 2, w / 2, 3) of an RGGB sensor: black taken off, white 1, the mean of the two greens."""
    x = (raw.astype(np.float64) - shot.black) / (shot.white - shot.black)
    return np.stack([x[::2, ::2], (x[::2, 1::2] + x[1::2, ::2]) / 2, x[1::2, 1::2]], -1)


def developed(raw: np.ndarray, shot: Shot) -> np.ndarray:
    """Linear Rec.709, white balanced to green 1 (the colour matrix normalised so that white stays white)."""
    from_rec709 = COLOUR_MATRIX @ TO_XYZ
    to_rec709 = np.linalg.inv(from_rec709 / from_rec709.sum(1, keepdims=True))
    return camera_values(raw, shot) / np.array(shot.neutral) * shot.neutral[1] @ to_rec709.T


def error_of(path: Path) -> str:
    with pytest.raises(BadInput) as caught:
        read_reference(view(path))
    message = str(caught.value)
    assert "\n" not in message and message.startswith(f"{path}: ")
    assert len(message.partition(": ")[2].split("; ")) == 2, message  # what is wrong; what to do
    return message


def test_black_white_balance_and_matrix(tmp_path):
    shot, raw = Shot(), samples()
    found = read_reference(view(save_dng(tmp_path / "a.dng", raw, shot)))
    assert found.valid.all() and not found.warnings and found.clipped_share == 0
    # float32, and LibRaw's matrices of XYZ in six digits
    np.testing.assert_allclose(found.rgb[::-1], developed(raw, shot), atol=1e-4)


def test_as_libraw_develops(tmp_path):
    """Where it does not cut: between 0 and 1, to three of its 65535 steps."""
    path = save_dng(tmp_path / "a.dng", samples(3000, 6000))
    with rawpy.imread(str(path)) as raw:
        theirs = raw.postprocess(
            half_size=True, gamma=(1, 1), no_auto_bright=True, use_camera_wb=True, output_bps=16, user_flip=0,
            output_color=rawpy.ColorSpace.sRGB) / 65535
    ours = read_reference(view(path)).rgb[::-1]
    inside = (theirs > 0.001) & (theirs < 0.999)
    assert inside.mean() > 0.8
    np.testing.assert_allclose(ours[inside], theirs[inside], atol=6e-5)


def test_what_lies_below_black_is_kept(tmp_path):
    """Noise about the black level: its mean stays 0, where a cut would lift it."""
    shot = Shot()
    raw = np.round(shot.black + RNG.normal(0, 60, (200, 300))).astype(np.uint16)
    raw[:40] = samples(4000, 6000, (40, 300))
    found = read_reference(view(save_dng(tmp_path / "a.dng", raw, shot)))
    dark = found.rgb[::-1][20:]
    assert found.valid.all() and (dark < 0).mean() > 0.3
    spread = dark.std() / dark[..., 0].size**0.5
    assert np.abs(dark.mean((0, 1))).max() < 4 * spread


def test_saturated_samples_are_clipped_whatever_is_beside_them(tmp_path):
    shot = Shot()
    raw = samples()
    raw[10, 21] = shot.white  # one of two greens
    raw[4, 6] = shot.black + 0.995 * (shot.white - shot.black)  # within the last hundredth: red
    found = read_reference(view(save_dng(tmp_path / "a.dng", raw, shot)))
    assert sorted(map(tuple, np.argwhere(~found.valid[::-1]).tolist())) == [(2, 3), (5, 10)]
    assert found.clipped_share == pytest.approx(2 / 600)


@pytest.mark.parametrize(("stated", "found"), [(0.8, 0.8), (1.0, 0.99), (0.2, 0.99)])
def test_samples_above_the_files_own_limit_are_clipped(tmp_path, stated, found):
    """DNG 1.4, LinearResponseLimit.  A limit in the lower half is none."""
    shot = Shot(linear=stated)
    raw = samples(1000, 8000)
    limit = shot.black + found * (shot.white - shot.black)
    raw[10, 21], raw[4, 6], raw[20, 20] = limit + 2, limit - 2, shot.white  # a green, a red, a red
    path = save_dng(tmp_path / "a.dng", raw, shot)
    half, full = read_reference(view(path)), read_reference(replace(view(path), full_raw=True))
    assert sorted(map(tuple, np.argwhere(~half.valid[::-1]).tolist())) == [(5, 10), (10, 10)]
    valid = half.valid[::-1]
    np.testing.assert_allclose(half.rgb[::-1][valid], developed(raw, shot)[valid], atol=1e-4)
    invalid = ~full.valid[::-1]
    assert invalid[10, 21] and invalid[20, 20] and not invalid[4, 6]


def test_a_dead_sample_does_not_spoil_a_picture(tmp_path):
    """Canon's black level is an eighth of white: a sample of 0 is far below what noise reaches."""
    shot = Shot(black=2048, white=15300)
    raw = samples(3000)
    raw[10, 21], raw[4, 6] = 0, 2048 - 600  # a green; a red with much noise, 4.5 % of white below black
    path = save_dng(tmp_path / "a.dng", raw, shot)
    half, full = read_reference(view(path)), read_reference(replace(view(path), full_raw=True))
    assert np.argwhere(~half.valid[::-1]).tolist() == [[5, 10]] and not full.valid[::-1][10, 21]
    valid = half.valid[::-1]
    np.testing.assert_allclose(half.rgb[::-1][valid], developed(raw, shot)[valid], atol=1e-4)


@pytest.mark.parametrize("kind", ["half", "full", "linear"])
def test_clipped_pixels_hold_what_is_there_at_least(tmp_path, kind):
    """White highlights over paint of all colours, beside the same exposed an eighth as long."""
    shot, size = Shot(black=2000), (27, 40, 1)
    paint = RNG.uniform(0.02, 0.6, size) * RNG.uniform(0.4, 1, (27, 40, 3))
    light = (paint + RNG.uniform(-1, 3, size).clip(0)).repeat(3, 0).repeat(3, 1)[:80]
    from_rec709 = COLOUR_MATRIX @ TO_XYZ
    camera = light @ (from_rec709 / from_rec709.sum(1, keepdims=True)).T * shot.neutral
    if kind != "linear":
        y, x = np.indices(camera.shape[:2])
        camera = np.take_along_axis(camera, BAYER[y % 2, x % 2][..., None], 2)[..., 0]
    dead = (RNG.random(camera.shape) < 0.05) & (camera < 1)
    found = []
    for factor in (1, 1 / 8):
        raw = np.round(shot.black + (camera * factor).clip(0, 1) * (shot.white - shot.black))
        raw[dead & (factor == 1)] = shot.black - 0.1 * (shot.white - shot.black)
        path = save_dng(tmp_path / f"{factor}.dng", raw.astype(np.uint16), shot)
        found.append(read_reference(replace(view(path), full_raw=kind == "full")))
    lost, least, true = ~found[0].valid, found[0].rgb, (8 * found[1].rgb).clip(0)
    assert lost.mean() > 0.4 and found[1].valid.all() and (least[lost] >= 0).all()
    above = (least - true)[lost]  # some pixels' samples of one colour show other paint than those of another
    assert (above > 0.02).mean() < 0.01
    # A channel that falls where a clipped one rises is unknown; so are, at full size, the edges of highlights.
    assert ((least[lost] > 0.1).mean(0) > (0.2 if kind == "full" else 0.4)).all()
    if kind == "linear":
        white = least[lost & (true.min(-1) > 2.1)]  # all are clipped: green is, of the balanced ones, at the lowest end
        assert above.max() < 0.01 and np.median(np.abs(white - 0.99)) < 1e-3


def test_xtrans_pixels_are_of_three_by_three_samples(tmp_path):
    shot = Shot(pattern=XTRANS)
    raw = samples(size=(42, 60))
    file = open_image(save_dng(tmp_path / "a.dng", raw, shot))
    assert (file.width, file.height) == (20, 14)
    x = (raw.astype(np.float64) - shot.black) / (shot.white - shot.black)
    colours = np.tile(XTRANS, (7, 10))
    want = np.array([[[x[y:y + 3, c:c + 3][colours[y:y + 3, c:c + 3] == k].mean() for k in range(3)]
                      for c in range(0, 60, 3)] for y in range(0, 42, 3)])
    np.testing.assert_allclose(file.read(0, 14), want, atol=1e-6)
    np.testing.assert_allclose(file.read(5, 12), want[5:12], atol=1e-6)


@pytest.mark.parametrize("full", [False, True])
@pytest.mark.parametrize("orientation", [1, 6])
def test_a_dng_whose_pixels_have_all_colours(tmp_path, monkeypatch, full, orientation):
    """LinearRaw, as Lightroom, ProRAW and noise filters write it: black, white, balance and matrix as of a sensor's."""
    monkeypatch.setattr(oiio_reader, "BAND", 300)  # several bands
    shot, raw = Shot(black=1000, orientation=orientation), RNG.integers(900, 14000, (41, 62, 3)).astype(np.uint16)
    raw[7, 9], raw[30, 1, 2], raw[20, 20, 1] = 15000, 14990, 0  # clipped, clipped in one channel, dead
    path = save_dng(tmp_path / "a.dng", raw, shot)
    file = open_image(path)
    assert (file.width, file.height) == ((62, 41) if orientation == 1 else (41, 62))
    assert file.shot == open_image(save_dng(tmp_path / "b.dng", samples(), shot)).shot
    found = read_reference(replace(view(path, file.width / file.height), full_raw=full))
    camera = (raw.astype(np.float64) - shot.black) / (shot.white - shot.black)
    lost = np.zeros((41, 62), bool)
    lost[7, 9] = lost[30, 1] = lost[20, 20] = True
    rgb, valid = found.rgb[::-1], found.valid[::-1]
    if orientation == 6:  # seen from the stored picture: rows from the right, columns from the top
        rgb, valid = np.rot90(rgb), np.rot90(valid)
    np.testing.assert_array_equal(valid, ~lost)
    from_rec709 = COLOUR_MATRIX @ TO_XYZ
    to_rec709 = np.linalg.inv(from_rec709 / from_rec709.sum(1, keepdims=True))
    np.testing.assert_allclose(rgb[valid], (camera / np.array(shot.neutral) * shot.neutral[1] @ to_rec709.T)[valid],
                               atol=2e-4)


def test_a_dng_of_floats_is_refused_in_a_line(tmp_path):
    """LibRaw scales a file with values above its white level by its largest value."""
    for shape in ((40, 60, 3), (40, 60)):
        raw = RNG.uniform(0, 7, shape).astype(np.float32)
        assert "a DNG of floats" in error_of(save_dng(tmp_path / "a.dng", raw, Shot(black=0, white=1)))


def spread_of(own: np.ndarray, values: np.ndarray, y: int, x: int, reach: int) -> float:
    """The weighted mean of a colour's samples about one place, sample by sample."""
    period = 2 if reach == 1 else 6
    total = weights = 0.0
    for dy in range(-reach, reach + 1):
        for dx in range(-reach, reach + 1):
            r, c = (at + period if at < 0 else at - period if at >= count else at
                    for at, count in ((y + dy, len(own)), (x + dx, own.shape[1])))
            if own[r, c]:
                weight = (reach + 1 - abs(dy)) * (reach + 1 - abs(dx))
                total, weights = total + weight * values[r, c], weights + weight
    return total / weights


@pytest.mark.parametrize(("pattern", "size"), [(None, (41, 60)), (XTRANS, (43, 62))])
def test_full_size(tmp_path, monkeypatch, pattern, size):
    """A pixel for each sample of whole blocks: its own kept, the others' by the weights; in bands as at once."""
    shot, raw = Shot(pattern=pattern), samples(size=size)
    path = save_dng(tmp_path / "a.dng", raw, shot)
    file, half = open_image(path, full=True), open_image(path)
    block, n = (2, 2) if pattern is None else (3, 6)
    assert (file.width, file.height) == (half.width * block, half.height * block)
    assert (file.shot, file.camera) == (half.shot, half.camera)
    pixels = file.read(0, file.height)
    x = (raw.astype(np.float64) - shot.black) / (shot.white - shot.black)
    x = x[:file.height, :file.width]
    colours = np.array([[((np.array([[0, 1], [1, 2]]) if pattern is None else XTRANS)[r % n, c % n])
                         for c in range(file.width)] for r in range(file.height)])
    for colour in range(3):
        own = colours == colour
        np.testing.assert_allclose(pixels[..., colour][own], x[own], atol=1e-6)
        for at in [(0, 0), (file.height - 1, file.width - 1), (7, 12), (8, 13), (9, 13), (10, 14), (11, 15)]:
            if not own[at]:
                assert pixels[at][colour] == pytest.approx(spread_of(own, x, *at, block - 1), abs=1e-6)
    monkeypatch.setattr(oiio_reader, "BAND", 70)
    np.testing.assert_array_equal(file.read(0, file.height), pixels)
    np.testing.assert_array_equal(file.read(3, 14), pixels[3:14])


def test_full_size_of_what_changes_evenly(tmp_path):
    """Bilinear: exact away from the edges.  Its means over 2 x 2 are then nearly those of the binned picture."""
    y, x = np.indices((40, 60))
    path = save_dng(tmp_path / "a.dng", (3000 + 40 * x + 25 * y).astype(np.uint16))
    full = open_image(path, full=True).read(0, 40)
    want = (3000 + 40 * x + 25 * y - 512) / (15000 - 512)
    np.testing.assert_allclose(full[1:-1, 1:-1], np.repeat(want[1:-1, 1:-1, None], 3, 2), atol=1e-6)
    means = full.reshape(20, 2, 30, 2, 3).mean((1, 3))
    np.testing.assert_allclose(means[1:-1, 1:-1], open_image(path).read(0, 20)[1:-1, 1:-1], atol=40 / 14488)


def test_full_size_of_saturated_samples(tmp_path):
    """Wherever one has a part, all is clipped."""
    raw = samples()
    raw[10, 20] = Shot().white  # red
    path = save_dng(tmp_path / "a.dng", raw, Shot(orientation=1))
    found = read_reference(replace(view(path), full_raw=True))
    assert found.rgb.shape == (40, 60, 3)
    clipped = {(y, x) for y in (9, 10, 11) for x in (19, 20, 21)}
    assert set(map(tuple, np.argwhere(~found.valid[::-1]).tolist())) == clipped
    upright = open_image(save_dng(tmp_path / "b.dng", raw, Shot(orientation=6)), full=True)
    assert (upright.width, upright.height) == (40, 60)


def test_one_white_balance_for_all(tmp_path):
    """Two pictures of one thing, whose camera balanced them by itself, say the same under one picture's factors."""
    raw, one, other = samples(), Shot(), Shot(neutral=(0.8, 1.0, 0.4))
    first, second = (save_dng(tmp_path / f"{n}.dng", raw, shot) for n, shot in enumerate((one, other)))
    assert np.abs(read_reference(view(first)).rgb - read_reference(view(second)).rgb).max() > 0.1
    camera = open_image(first).camera
    assert camera is not None and camera.white_balance == pytest.approx((2.0, 1.0, 1.6))
    rendered = save(tmp_path / "c.exr", np.full((20, 30, 3), 0.5, np.float32))
    views = with_one_white_balance([view(rendered), view(first), view(second)])
    assert [v.white_balance for v in views] == [None, camera.white_balance, camera.white_balance]
    np.testing.assert_array_equal(read_reference(views[2]).rgb, read_reference(view(first)).rgb)


def test_a_file_is_unpacked_for_its_header_once_until_it_changes(tmp_path, monkeypatch):
    """A large one takes half a second, and every step asks for it."""
    asked = []
    of_file = decoder_pool.header
    monkeypatch.setattr(decoder_pool, "header", lambda *given: asked.append(given) or of_file(*given))
    path = save_dng(tmp_path / "a.dng", np.full((40, 60), 1000, np.uint16))
    first = open_image(path)
    assert open_image(path) == first and open_image(path, full=True) != first
    read_reference(view(path))
    assert len(asked) == 2
    save_dng(path, np.full((44, 60), 1000, np.uint16))
    assert (first.height, open_image(path).height) == (20, 22)


def test_what_exif_says(tmp_path):
    shot = open_image(save_dng(tmp_path / "a.dng", samples(), Shot(exposure=(1 / 60, 11.0, 400)))).shot
    assert (shot.time, shot.f_number, shot.iso) == pytest.approx((1 / 60, 11.0, 400))
    bare = open_image(save_dng(tmp_path / "b.dng", samples(), Shot(exposure=None))).shot
    assert (bare.time, bare.f_number, bare.iso, bare.exposure_value) == (None, None, None, None)


@pytest.mark.parametrize(("orientation", "turn"), [
    (2, lambda p: p[:, ::-1]), (3, lambda p: p[::-1, ::-1]), (4, lambda p: p[::-1]), (5, lambda p: p.swapaxes(0, 1)),
    (6, lambda p: np.rot90(p, -1)), (7, lambda p: np.rot90(p, 2).swapaxes(0, 1)), (8, lambda p: np.rot90(p, 1)),
])
def test_orientation(tmp_path, orientation, turn):
    raw, shot = samples(), Shot(orientation=orientation)
    path = save_dng(tmp_path / "a.dng", raw, shot)
    found = read_reference(view(path, aspect=2 / 3 if orientation >= 5 else 1.5))
    np.testing.assert_allclose(found.rgb[::-1], turn(developed(raw, shot)), atol=1e-4)
    if orientation in (3, 5, 6, 8):  # those LibRaw itself turns for sure
        with rawpy.imread(str(path)) as file:
            assert file.postprocess(half_size=True).shape[:2] == found.valid.shape


def test_bands_change_nothing(tmp_path, monkeypatch):
    for pattern in (None, XTRANS):
        path = save_dng(tmp_path / "a.dng", samples(size=(96, 60)), Shot(pattern=pattern))
        whole = open_image(path)
        pixels = whole.read(0, whole.height)
        monkeypatch.setattr(oiio_reader, "BAND", 90)
        np.testing.assert_array_equal(whole.read(0, whole.height), pixels)
        np.testing.assert_array_equal(whole.read(3, 29), pixels[3:29])
        monkeypatch.undo()


# --- what cannot be used


def test_unknown_cameras_and_other_sensors(tmp_path):
    (tmp_path / "a.nef").write_bytes(b"no camera wrote this" * 200)
    assert "knows no camera" in error_of(tmp_path / "a.nef")
    plain = save(tmp_path / "b.tif", RNG.integers(0, 255, (20, 30, 3)).astype(np.uint8), "uint8")
    os.rename(plain, tmp_path / "b.dng")
    assert "knows no camera" in error_of(tmp_path / "b.dng")
    assert "colours of its camera" in error_of(
        save_dng(tmp_path / "c.dng", samples(), Shot(matrix=np.zeros((0, 0)))))
    assert "sensor without" in error_of(
        save_dng(tmp_path / "d.dng", samples(), Shot(pattern=np.array([[0, 1], [1, 2], [1, 0], [2, 1]]))))
    assert "image not found" in error_of(tmp_path / "none.dng")
    assert "white level" in error_of(save_dng(tmp_path / "e.dng", samples(), Shot(black=900, white=800)))


def test_a_cut_file(tmp_path):
    path = save_dng(tmp_path / "a.dng", samples())
    content = path.read_bytes()
    for share in (0.05, 0.3):
        path.write_bytes(content[:int(len(content) * share)])
        error_of(path)


def test_without_rawpy_one_line_says_so(tmp_path, monkeypatch):
    pool = decoder_pool._Pool()
    monkeypatch.setattr(decoder_pool, "_pool", pool)
    program = "import sys; sys.modules['rawpy'] = None; " + decoder_pool.program()
    monkeypatch.setattr(decoder_pool, "program", lambda: program)
    assert "rawpy is missing" in error_of(save_dng(tmp_path / "a.dng", samples()))
    assert read_reference(view(save(tmp_path / "a.exr", np.full((20, 30, 3), 0.5, np.float32)))).valid.all()
    pool.close()


def test_rawpy_stays_in_the_decoders(tmp_path):
    path = save_dng(tmp_path / "a.dng", samples())
    code = ("import sys; from pathlib import Path; from irpso_addon.core.images.image_file import open_image; "
            f"open_image(Path({str(path)!r})).read(0, 20); assert 'rawpy' not in sys.modules")
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.tuples(st.integers(0, 420), st.integers(0, 255)), min_size=1, max_size=6))
def test_damaged_headers_are_bad_input_or_read(tmp_path, changes):
    path = save_dng(tmp_path / "a.dng", samples())
    content = bytearray(path.read_bytes())
    for at, value in changes:
        content[at] = value
    path.write_bytes(content)
    try:
        file = open_image(path)
        found = read_reference(view(path, aspect=file.width / file.height))
    except BadInput as error:
        assert "\n" not in str(error)
    else:
        assert np.isfinite(found.rgb).all()


def test_exif_of_a_tiff(tmp_path):
    """By tags that no library wrote here."""
    path = tmp_path / "a.tif"
    path.write_bytes(tiff(
        [(256, "I", [6]), (257, "I", [4]), (258, "H", [16, 16, 16]), (259, "H", [1]), (262, "H", [2]),
         (271, "s", ["Acme"]), (272, "s", ["Two"]), (273, "I", [0]), (274, "H", [6]), (277, "H", [3]), (278, "I", [4]),
         (279, "I", [144]), (284, "H", [1]), (34665, "I", [0])],
        [(33434, "R", [0.25]), (33437, "R", [5.6]), (34855, "H", [100]), (36867, "s", ["2026:01:02 03:04:05"]),
         (37386, "R", [35.0])], RNG.integers(0, 60000, 72).astype("<u2").tobytes()))
    file = open_image(path)
    assert (file.width, file.height, file.orientation) == (4, 6, 6)
    shot = file.shot
    assert (shot.time, shot.f_number, shot.iso) == pytest.approx((0.25, 5.6, 100))
    assert replace(shot, iso=None).exposure_value is None
    assert shot.exposure_value == pytest.approx(np.log2(0.25 * 100 / 100 / 5.6**2))


TIFF = [(256, "I", [6]), (257, "I", [4]), (258, "H", [16, 16, 16]), (259, "H", [1]), (262, "H", [2]), (273, "I", [0]),
        (277, "H", [3]), (278, "I", [4]), (279, "I", [144]), (284, "H", [1]), (34665, "I", [0])]


@pytest.mark.parametrize(("exif", "found"), [
    # ShutterSpeedValue and ApertureValue, which old cameras and some programs write alone: 1/64 s and f/4
    ([(34855, "H", [100]), (37377, "r", [6.0]), (37378, "R", [4.0])], (1 / 64, 4, 100)),
    ([(34855, "H", [100]), (37377, "r", [-2.0]), (37378, "R", [0.0])], (4, None, 100)),  # 4 s; a lens without contacts
    # the rounded values count less
    ([(33434, "R", [0.016]), (33437, "R", [4.1]), (34855, "H", [100]), (37377, "r", [6.0]), (37378, "R", [4.0])],
     (0.016, 4.1, 100)),
    # ISO 102400: 16 bits do not hold it, so EXIF 2.3 has a longer field
    ([(33434, "R", [0.01]), (33437, "R", [4.0]), (34855, "H", [65535]), (34864, "H", [2]), (34866, "I", [102400])],
     (0.01, 4, 102400)),
    ([(33434, "R", [0.01]), (33437, "R", [4.0]), (34855, "H", [65535])], (0.01, 4, None)),
])
def test_other_fields_of_exif(tmp_path, exif, found):
    path = tmp_path / "a.tif"
    path.write_bytes(tiff(TIFF, exif, RNG.integers(0, 60000, 72).astype("<u2").tobytes()))
    shot = open_image(path).shot
    assert [shot.time, shot.f_number, shot.iso] == [None if n is None else pytest.approx(n, rel=1e-6) for n in found]


def test_an_iso_that_a_raw_file_cannot_hold_is_none(tmp_path):
    assert open_image(save_dng(tmp_path / "a.dng", samples(), Shot(exposure=(0.01, 4.0, 65535)))).shot.iso is None


def test_suffixes_are_told_whatever_their_case():
    assert raw_reader.is_raw(Path("A.NEF")) and not raw_reader.is_raw(Path("a.tiff"))

