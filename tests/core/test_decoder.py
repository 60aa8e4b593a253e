"""Images are decoded in another process, whatever happens to it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.core.errors import BadInput
from irpso_addon.core.images import decoder_pool, oiio_reader
from irpso_addon.core.images.image_file import floats, open_image
from irpso_addon.core.images.mask import Mask
from irpso_addon.core.images.oiio_reader import StoredPicture
from irpso_addon.core.images.reference_image import read_reference
from tests.support.picture_files import save, view
from tests.support.random_pictures import noise

oiio = pytest.importorskip("OpenImageIO")
ROOT = Path(__file__).parents[2]
POSIX = pytest.mark.skipif(os.name == "nt", reason="sends signals")


@pytest.fixture(autouse=True)
def own_processes(monkeypatch):
    pool = decoder_pool._Pool()
    monkeypatch.setattr(decoder_pool, "_pool", pool)
    yield pool
    pool.close()


@pytest.fixture
def large(tmp_path):
    """An image of many bands."""
    pixels = np.tile(noise(100, 1000), (20, 1, 1))
    return open_image(save(tmp_path / "large.exr", pixels, "half", compression="none")), pixels


def alive(number: int) -> bool:
    try:
        return Path(f"/proc/{number}/stat").read_text().split(")")[1].split()[0] != "Z"
    except OSError:
        return False


def test_what_comes_through_is_what_is_decoded(large):
    file, pixels = large
    bands = list(file.bands())
    assert len(bands) > 3 and sum(map(len, bands)) == 2000
    np.testing.assert_array_equal(np.concatenate(bands), pixels.astype(np.float16))
    np.testing.assert_array_equal(file.read(701, 1302), pixels[701:1302].astype(np.float16))


@pytest.mark.parametrize("form", ["uint8", "uint16"])
def test_integers_become_the_floats_that_openimageio_makes_of_them(tmp_path, form):
    every = np.arange(np.iinfo(form).max + 1, dtype=form).reshape(16, -1, 1)
    path = save(tmp_path / "a.tif", every, form, "Y")
    np.testing.assert_array_equal(floats(every), oiio.ImageInput.open(str(path)).read_image(0, 0, 0, 1, oiio.FLOAT))


@pytest.mark.parametrize("size", [(38, 57), (200, 300), (20, 30)])
def test_masks_of_other_sizes_are_filtered_as_openimageio_does(tmp_path, monkeypatch, size):
    monkeypatch.setattr(oiio_reader, "BAND", 900)
    grey = noise(*size, 1)
    image = open_image(save(tmp_path / "i.exr", noise(60, 90)))
    rows = Mask(save(tmp_path / "m.exr", grey, names="Y"), image).rows()
    found = np.concatenate([rows.take(n) for n in (1, 20, 32, 7)])
    whole = oiio.ImageBuf(oiio.ImageSpec(size[1], size[0], 1, "float"))
    whole.set_pixels(oiio.ROI(), grey)
    true = oiio.ImageBufAlgo.resize(whole, filtername="triangle", roi=oiio.ROI(0, 90, 0, 60, 0, 1, 0, 1))
    np.testing.assert_allclose(found, true.get_pixels(oiio.FLOAT)[..., 0], atol=1e-5)


def test_no_decoder_in_this_process(tmp_path):
    """A reference with a mask, a thumbnail and maps of known truth are read, and OpenImageIO is never loaded."""
    path = save(tmp_path / "ball_basecolor.exr", noise(30, 30))
    save(tmp_path / "ball_roughness.exr", noise(30, 30, 1), names="Y")
    code = ("import sys; from pathlib import Path; from irpso_addon.core.capture import file_preview; "
            "from irpso_addon.core.evaluation import ground_truth; "
            "from irpso_addon.core.images import reference_image; "
            "from irpso_addon.core.tiled import reference_cache; "
            "from irpso_addon.core.data import Camera, View; import numpy as np; "
            "camera = Camera('c', np.eye(4), np.eye(4), np.zeros(3), np.zeros(3), False, 1.0); "
            f"path = Path({str(path)!r}); view = View(path, camera, (), mask=path); "
            "reference_image.read_reference(view); reference_image.read_reference(view, 100); "
            "reference_cache.cache_reference(view, path.with_name('p')); "
            "assert not file_preview.preview_image(path).problem; ground_truth.read_truth(path.parent, 'ball'); "
            "assert 'OpenImageIO' not in sys.modules")
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True)


@POSIX
@pytest.mark.parametrize("number", [signal.SIGSEGV, signal.SIGKILL])
def test_a_decoder_that_crashes_is_said_and_replaced(large, own_processes, number):
    file, _ = large
    bands = file.bands()
    next(bands)
    os.kill(own_processes.busy[0].number, number)
    with pytest.raises(BadInput, match=rf"large\.exr: cannot be read \(its decoder ended with status -{number}\)"):
        list(bands)
    assert not own_processes.busy and not own_processes.idle
    assert len(list(file.bands())) > 3


@POSIX
def test_ctrl_c_in_a_terminal_is_not_for_decoders(tmp_path, large, own_processes):
    """It goes to all processes of the terminal: the command line is to say that it was cancelled, not a bad file."""
    file, pixels = large
    bands = file.bands()
    first = next(bands)
    os.kill(own_processes.busy[0].number, signal.SIGINT)
    np.testing.assert_array_equal(np.concatenate([first, *bands]), pixels.astype(np.float16))


@POSIX
def test_the_status_told_is_the_decoders_own(tmp_path, monkeypatch):
    """Its pipe is closed some time before it ends."""
    monkeypatch.setattr(decoder_pool, "program", lambda: "import os, time; os.close(1); time.sleep(0.1); os._exit(7)")
    with pytest.raises(BadInput, match=r"a\.exr: cannot be read \(its decoder ended with status 7\)"):
        open_image(save(tmp_path / "a.exr", noise()))


def test_a_python_without_openimageio_is_told_what_to_install(tmp_path, own_processes, monkeypatch):
    program = "import sys; sys.modules['OpenImageIO'] = None; " + decoder_pool.program()
    monkeypatch.setattr(decoder_pool, "program", lambda: program)
    with pytest.raises(BadInput, match=r"OpenImageIO cannot be loaded.*pip install OpenImageIO"):
        open_image(save(tmp_path / "a.exr", noise()))
    assert not own_processes.idle and not own_processes.busy


@POSIX
def test_a_decoder_that_stalls_is_ended(large, own_processes, monkeypatch):
    monkeypatch.setattr(decoder_pool, "PATIENCE", 0.4)
    file, _ = large
    bands = file.bands()
    next(bands)
    process = own_processes.busy[0]
    os.kill(process.number, signal.SIGSTOP)
    start = time.perf_counter()
    with pytest.raises(BadInput, match=r"large\.exr: cannot be read \(decoding it stalled"):
        list(bands)
    assert time.perf_counter() - start < 5 and not process.alive
    monkeypatch.setattr(decoder_pool, "PATIENCE", 10)
    assert len(list(file.bands())) > 3


@POSIX
def test_who_waits_with_taking_is_not_stalled(large, own_processes, monkeypatch):
    monkeypatch.setattr(decoder_pool, "PATIENCE", 0.3)
    bands = large[0].bands()
    next(bands)
    time.sleep(1.0)
    assert len(list(bands)) > 2


@pytest.mark.skipif(sys.platform != "linux", reason="the system may not limit memory")
def test_memory_of_a_decoder_is_limited(tmp_path, monkeypatch):
    """Tiles as wide as the image and as tall as allowed: a row of them is more than the limit."""
    path = save(tmp_path / "a.exr", np.zeros((2048, 2048, 4), np.float32), tile_width=2048, tile_height=2048)
    monkeypatch.setattr(decoder_pool, "MEMORY", 120_000_000)
    with pytest.raises(BadInput, match=r"a\.exr: cannot be read|a\.exr: is damaged") as caught:
        read_reference(view(path, 1.0))
    assert "\n" not in str(caught.value)
    assert open_image(save(tmp_path / "b.exr", noise())).read(0, 20).shape == (20, 30, 3)


@pytest.mark.parametrize("answer", [
    "hello", "{}", '{"header": {}}', '{"header": 3}', "[[[[" * 5000, "\\xff\\xfe", '{"rows": -4}', '{"rows": 1e99}',
    '{"rows": 1e999, "header": {"part": 1e999, "channels": [1e999], "window": []}}',
    '{"header": {"part": 0, "channels": [0, 1, 2], "window": [0, 0, 9, 9], "width": 99999, "height": 9, "form": "half",'
    ' "bits": 16, "integer": false, "premultiplied": true, "colorspace": null, "warnings": []}}',
    *('{"header": {"part": 0, "channels": [0, 1, 2], "window": [0, 0, 30, 20], "width": 30, "height": 20, "form": '
      '"float", "bits": 32, "integer": false, "premultiplied": true, "colorspace": null, "warnings": [], '
      '"orientation": 1, "camera": null, "shot": ' + shot + "}}" for shot in ('"x"', "null", "[3]")),
])
def test_nonsense_is_not_believed(tmp_path, monkeypatch, answer):
    """What a decoder that a file has taken over might say."""
    program = f"""import sys; sys.stdout.buffer.write(b'{{"ready": true}}\\n{answer}\\n'); sys.stdout.flush()
sys.stdin.read()"""
    monkeypatch.setattr(decoder_pool, "program", lambda: program)
    path = save(tmp_path / "a.exr", noise())
    with pytest.raises(BadInput, match=r"a\.exr: cannot be read \(its decoder sent invalid data"):
        open_image(path)
    with pytest.raises(BadInput, match=r"a\.exr: cannot be read"):
        list(decoder_pool.bands(path, StoredPicture(0, (0, 1, 2), "float", (30, 20)), 0, 20))


def test_a_file_that_changes_is_not_read_as_it_was(tmp_path):
    file = open_image(save(tmp_path / "a.exr", noise()))
    save(tmp_path / "a.exr", noise(10, 10))
    with pytest.raises(BadInput, match=r"a\.exr: changed"):
        file.read(0, 20)


def test_a_process_outlives_a_short_rest_that_nobody_wants(tmp_path, own_processes, monkeypatch):
    monkeypatch.setattr(oiio_reader, "BAND", 900)
    file = open_image(save(tmp_path / "a.exr", noise(200, 30)))
    for _ in range(3):
        assert len(next(file.bands())) < 200
    assert len(own_processes.idle) == 1 and not own_processes.busy
    number = own_processes.idle[0].number
    assert file.read(0, 200).shape == (200, 30, 3) and own_processes.idle[0].number == number


@POSIX
def test_what_is_no_image_file_is_said_at_once(tmp_path):
    os.mkfifo(tmp_path / "pipe.exr")
    for path, words in ((tmp_path / "pipe.exr", "is not a file"), (Path("/dev/zero"), "is not a file"),
                        (tmp_path, "is a folder"), (tmp_path / ("a" * 300), "image not found"),
                        (tmp_path.joinpath(*["b" * 200] * 25), "image not found")):
        with pytest.raises(BadInput, match=f": {words}"):
            open_image(path)


def test_only_formats_of_pictures_are_decoded(tmp_path):
    path = tmp_path / "a.gif"
    path.write_bytes(b"GIF89a\x01\0\x01\0\x80\0\0\0\0\0\xff\xff\xff,\0\0\0\0\x01\0\x01\0\0\x02\x02D\x01\0;")
    with pytest.raises(BadInput, match=r"a\.gif: cannot be read as an image"):
        open_image(path)


def test_threads_and_bands_that_nobody_finishes(large, own_processes):
    file, pixels = large
    next(file.bands())
    assert not own_processes.busy
    with ThreadPoolExecutor(4) as threads:
        for found in threads.map(lambda _: file.read(0, 2000), range(4)):
            np.testing.assert_array_equal(found, pixels.astype(np.float16))
    assert not own_processes.busy and 1 <= len(own_processes.idle) <= 4


@POSIX
def test_processes_end_when_unused_and_with_us(tmp_path, own_processes, monkeypatch):
    path = save(tmp_path / "a.exr", noise())
    open_image(path)
    monkeypatch.setattr(decoder_pool, "UNUSED", 0.1)
    number = own_processes.idle[0].number
    _until(lambda: not alive(number))
    assert not any(thread.name == "irpso-decoders" for thread in threading.enumerate() if thread.is_alive()) or (
        _until(lambda: own_processes.watcher is None))
    code = ("import os; from pathlib import Path; from irpso_addon.core.images import decoder_pool; "
            f"decoder_pool.header(Path({str(path)!r})); print(decoder_pool._pool.idle[0].number, flush=True); "
            "os._exit(1)")
    told = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    _until(lambda: not alive(int(told.stdout)))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
def test_a_fork_has_processes_of_its_own(large):
    file, pixels = large
    bands = file.bands()
    first = next(bands)
    child = os.fork()
    if not child:
        try:
            os._exit(0 if np.array_equal(file.read(0, 2000), pixels.astype(np.float16)) else 1)
        finally:
            os._exit(2)
    assert os.waitpid(child, 0)[1] == 0
    np.testing.assert_array_equal(np.concatenate([first, *bands]), pixels.astype(np.float16))


def _until(condition) -> bool:
    end = time.monotonic() + 10
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)
    return True
