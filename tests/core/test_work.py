"""Bundles, work folders and merged maps of a large solve."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import typing
import zipfile
from dataclasses import fields, is_dataclass
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.core.check_records import Checks
from irpso_addon.core.data import Camera, Light, Maps, MeshArrays, NormalMap, SceneData, Solution, View, ViewPicture
from irpso_addon.core.errors import BadInput
from irpso_addon.core.lens import Lens
from irpso_addon.core.maps.block_merge import Target, merge, steps
from irpso_addon.core.maps.export import layers, write_maps
from irpso_addon.core.params import SolveSettings
from irpso_addon.core.storage.atomic_io import _FAR, LOCK, PART, FolderLock, remove_leftovers, replacing
from irpso_addon.core.tiled import npz_archive
from irpso_addon.core.tiled.tiled_plan import Plan
from irpso_addon.core.tiled.uv_blocks import all_blocks
from irpso_addon.core.tiled.work_folder import WorkFolder

ROOT = Path(__file__).parents[2]


def scene() -> SceneData:
    rng = np.random.default_rng(1)
    camera = Camera("Käm", rng.random((4, 4)), rng.random((4, 4)), rng.random(3), rng.random(3), False, 1.5,
                    lens=Lens(60, 40, 40.2, 40.1, 30.3, 19.5, (-0.1, 0.09, -0.03, 0.0), (6e-4, -3e-4), 0.2))
    mesh = MeshArrays("vase", *rng.random((2, 5, 3, 3)).astype(np.float32), rng.random((5, 3, 2)).astype(np.float32),
                      np.arange(5, dtype=np.int32), ("a", ""), normal_maps={2: NormalMap(
                          np.asfortranarray(rng.random((3, 4, 3)).astype(np.float32)), 0.5)})
    views = tuple(View(Path(f"/ref s/{n}.exr"), camera, (Light("L", "SUN", rng.random(3), np.eye(4)),), mask=mask)
                  for n, mask in ((1, None), (2, Path("m.png"))))
    return SceneData("scene", mesh, np.zeros((0, 3, 3), np.float32), views, warnings=("w",), skipped=(("a", "b"),))


def solution() -> Solution:
    nan = float("nan")
    checks = Checks("vase", (), (), (), nan, 0.0, float("inf"), None, -float("inf"), np.float64(0.5), 0.1,
                    1.0, nan, True, 2)
    picture = ViewPicture("a.exr", "C", ("L",), *np.full((2, 3, 4, 3), nan, np.float16), 2.0)
    return Solution(maps(8), {"m": "lambert"}, {}, {"solved": 3}, {"solve": 1.5}, 0.1, ("v",), (), (),
                    {"version": 450, "big": [1, None, True]}, checks=checks, pictures=(picture,))


def maps(n: int, two: bool = False) -> Maps:
    rng = np.random.default_rng(n)
    flat = rng.random((9, n, n)).astype(np.float32)
    return Maps(rng.random((n, n, 3)).astype(np.float32) * 1.2 - 0.1, flat[0], flat[1], flat[2], flat[3] > 0.5,
                flat[4] > 0.5, flat[5], flat[6], lobes=rng.random((n, n, 3)).astype(np.float32) if two else None,
                specular=flat[7] if two else None)


def same(a: object, b: object) -> bool:
    """Types and values alike, all the way down."""
    if type(a) is not type(b):
        return False
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    if is_dataclass(a):
        return all(same(getattr(a, f.name), getattr(b, f.name)) for f in fields(a))
    if isinstance(a, dict):
        return list(a) == list(b) and all(same(x, y) for x, y in zip(a.values(), b.values(), strict=True))
    if isinstance(a, tuple | list):
        return len(a) == len(b) and all(map(same, a, b))
    return repr(a) == repr(b)  # NaN too


@pytest.mark.parametrize("thing", [
    scene(), solution(), SolveSettings(size=64), None, (), [(1, 2.5), {"a": None, 3: (True,)}], np.float32(0.1),
    np.bool_(True), {"x": np.array(7), "y": np.zeros((0, 3), np.int64)}, Path("a/ü"), "\udcff\n", 2**80,
], ids=lambda t: type(t).__name__)
def test_bundle_gives_back_what_it_got(tmp_path, thing):
    npz_archive.save(tmp_path / "a.npz", thing)
    assert same(npz_archive.load(tmp_path / "a.npz"), thing)
    first = (tmp_path / "a.npz").read_bytes()
    npz_archive.save(tmp_path / "b.npz", npz_archive.load(tmp_path / "a.npz"))
    assert (tmp_path / "b.npz").read_bytes() == first  # the same thing, the same bytes
    with np.load(tmp_path / "a.npz", allow_pickle=False) as file:
        assert "thing.json" in file.files


def records_in(kind: object, found: set[type]) -> set[type]:
    """All dataclasses that values of a type may hold, by its fields' types."""
    if isinstance(kind, type) and is_dataclass(kind) and kind not in found:
        found.add(kind)
        for hint in typing.get_type_hints(kind).values():
            records_in(hint, found)
    for argument in typing.get_args(kind):
        records_in(argument, found)
    return found


@pytest.mark.parametrize("kind", [Solution, SceneData, Plan])
def test_bundle_knows_each_record_that_a_result_may_hold(kind):
    """A solve that refined normals could not be stored: its record was not among them."""
    assert records_in(kind, set()) <= set(npz_archive.RECORDS.values())


def test_loaded_arrays_can_be_changed_and_shared_ones_are_kept_once(tmp_path):
    array = np.arange(6.0)
    npz_archive.save(tmp_path / "a.npz", (array, array))
    a, b = npz_archive.load(tmp_path / "a.npz")
    a[0] = 5
    assert b[0] == 5 and len(zipfile.ZipFile(tmp_path / "a.npz").namelist()) == 2


@pytest.mark.parametrize("thing", [object(), {1, 2}, b"x", np.array(["a"]), np.array([None]), lambda: 0])
def test_bundle_refuses_what_it_does_not_know(tmp_path, thing):
    with pytest.raises(TypeError):
        npz_archive.save(tmp_path / "a.npz", thing)
    assert list(tmp_path.iterdir()) == []


def test_damage_is_told_with_the_file(tmp_path):
    path = tmp_path / "a.npz"
    npz_archive.save(path, scene())
    whole = path.read_bytes()
    rng = np.random.default_rng(0)
    for n in range(150):
        bad = bytearray(whole)
        if n % 2:
            bad = bad[:rng.integers(len(bad))]
        else:
            bad[rng.integers(len(bad))] ^= 1 << rng.integers(8)
        path.write_bytes(bad)
        try:
            assert same(npz_archive.load(path), scene())  # a bit that tells nothing: a date, a comment
        except BadInput as error:
            assert str(path) in str(error) and "\n" not in str(error)


def test_hostile_bundles(tmp_path):
    path = tmp_path / "a.npz"
    texts = ['{"format":2,"thing":{"record":"os.system","fields":{}}}', '{"format":2,"thing":{"array":"a0"}}',
             "[" * 10**5, '{"format":2,"thing":{"record":"View","fields":{"x":1}}}',
             '{"format":2,"thing":{"path":"a\\u0000"}}',
             '{"format":1,"thing":1}', "{}", "null", '{"format":2,"thing":{"dict":[[[],1]]}}']
    for text in texts:
        with zipfile.ZipFile(path, "w") as file:
            file.writestr("thing.json", text)
        with pytest.raises(BadInput, match=r"a\.npz"):
            npz_archive.load(path)
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }".ljust(117) + b"\n"
    for content, how in ((b"\x93NUMPY\x01\x00v\x00" + header, zipfile.ZIP_STORED),
                         (b"\0" * 10**7, zipfile.ZIP_DEFLATED)):
        with zipfile.ZipFile(path, "w", how) as file:
            file.writestr("thing.json", '{"format":2,"thing":1}')
            file.writestr("a0.npy", content)
        with pytest.raises(BadInput, match="damaged"):
            npz_archive.load(path)


def test_fingerprint(tmp_path):
    (tmp_path / "f").write_bytes(b"1")
    base = npz_archive.fingerprint(scene(), SolveSettings(), files=[tmp_path / "f"])
    assert base == npz_archive.fingerprint(scene(), SolveSettings(), files=[tmp_path / "f"]) and len(base) == 64
    others = {npz_archive.fingerprint(scene(), SolveSettings(size=64), files=[tmp_path / "f"]),
              npz_archive.fingerprint(scene(), SolveSettings()), npz_archive.fingerprint(SolveSettings(), scene())}
    (tmp_path / "f").write_bytes(b"2")
    others.add(npz_archive.fingerprint(scene(), SolveSettings(), files=[tmp_path / "f"]))
    assert base not in others and len(others) == 4
    with pytest.raises(BadInput, match="gone"):
        npz_archive.fingerprint(files=[tmp_path / "gone"])


BLOCK = {"roughness": np.ones((4, 4), np.float32)}


def test_work_keeps_what_is_of_the_same_solve(tmp_path):
    with WorkFolder(tmp_path / "w") as work:
        work.begin("one")
        assert work.read_plan() is None and not work.has_block("1001_y0_x0")
        work.write_plan(scene())
        work.write_block("1001_y0_x0", BLOCK)
        (work.pictures / "a").write_text("x")
    late = WorkFolder(tmp_path / "w")  # a farm's task: no lock
    assert same(late.read_plan(), scene()) and same(late.read_block("1001_y0_x0"), BLOCK)
    with WorkFolder(tmp_path / "w") as work:
        work.begin("one")
        assert work.has_block("1001_y0_x0") and (work.pictures / "a").exists()
        work.begin("two")
        assert not work.has_block("1001_y0_x0") and work.read_plan() is None and not list(work.pictures.iterdir())
        with pytest.raises(BadInput, match="w: the folder now belongs to another solve; stop"):
            late.write_block("1001_y0_x0", BLOCK)  # of the solve before
        assert not work.has_block("1001_y0_x0")
        work.write_block("1001_y0_x1", {"roughness": 2 * BLOCK["roughness"]})
        with pytest.raises(BadInput, match="another solve"):
            late.write_block("1001_y0_x1", BLOCK)
        assert same(work.read_block("1001_y0_x1"), {"roughness": 2 * BLOCK["roughness"]})
        with pytest.raises(BadInput, match="missing or damaged"):
            work.read_block("1001_y0_x0")
        work.remove()
    assert list(tmp_path.iterdir()) == []


def test_damaged_blocks_are_as_if_not_there(tmp_path):
    with WorkFolder(tmp_path) as work:
        work.begin("x")
        work.write_block("k", {"roughness": np.random.default_rng(0).random((64, 64)).astype(np.float32)})
        file, = (tmp_path / "blocks").iterdir()
        content = bytearray(file.read_bytes())
        content[len(content) // 2] ^= 1
        file.write_bytes(content)
        assert not work.has_block("k")


def test_two_at_once(tmp_path):
    code = ("import sys; from pathlib import Path; from irpso_addon.core.tiled.work_folder import WorkFolder\n"
            "with WorkFolder(Path(sys.argv[1])): print('in', flush=True); sys.stdin.read()")
    other = subprocess.Popen([sys.executable, "-c", code, str(tmp_path)], cwd=ROOT, stdin=subprocess.PIPE,
                             stdout=subprocess.PIPE, text=True)
    assert other.stdout is not None and other.stdout.readline() == "in\n"
    with pytest.raises(BadInput, match=rf"another irpso \(process {other.pid} on [\w.-]+\) is working there; wait, or"):
        WorkFolder(tmp_path).__enter__()
    other.kill()
    other.communicate()
    with WorkFolder(tmp_path) as work:  # whom the lock's file still names is dead
        work.begin("x")


ENTER = """
import sys, time
from pathlib import Path
from irpso_addon.core.storage.atomic_io import FolderLock
from irpso_addon.core.errors import BadInput
count, done = Path(sys.argv[1], "count"), 0
while done < 40:
    try:
        with FolderLock(count.parent):
            value = int(count.read_text())
            time.sleep(0.001)
            count.write_text(str(value + 1))
            done += 1
    except BadInput:
        time.sleep(0.001)
"""


def test_only_one_holds_a_lock_whoever_removes_it(tmp_path):
    """Processes enter and leave in turn, each time with a new file; a counter would lose where two are inside."""
    (tmp_path / "count").write_text("0")
    jobs = [subprocess.Popen([sys.executable, "-S", "-c", ENTER, str(tmp_path)], cwd=ROOT) for _ in range(3)]
    assert [job.wait(60) for job in jobs] == [0, 0, 0]
    assert (tmp_path / "count").read_text() == "120"


def test_somebodys_own_folder_is_refused(tmp_path):
    (tmp_path / "novel.txt").write_text("text")
    with pytest.raises(BadInput, match=r"contains 'novel\.txt' and is not a work folder"):
        WorkFolder(tmp_path).__enter__()
    assert [p.name for p in tmp_path.iterdir()] == ["novel.txt"]
    with pytest.raises(BadInput, match="is not a work folder"):
        WorkFolder(tmp_path).write_block("k", BLOCK)


def test_litter_of_systems_makes_a_folder_nobodys_own(tmp_path):
    for name in (".DS_Store", "Thumbs.db", "Desktop.ini", ".nfs00000000041a8f"):
        (tmp_path / name).write_text("x")
    (tmp_path / "@eaDir").mkdir()
    before = sorted(os.listdir(tmp_path))
    with WorkFolder(tmp_path) as work:
        work.begin("x")
        work.write_block("k", BLOCK)
        work.remove()
    assert sorted(os.listdir(tmp_path)) == before


def test_links_are_not_followed(tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "a").write_text("x")
    with WorkFolder(tmp_path / "w") as work:
        work.begin("a")
        (work.folder / "pictures").rmdir()
        (work.folder / "pictures").symlink_to(tmp_path / "mine")
        work.begin("b")
        assert not work.pictures.is_symlink()
        (work.folder / "blocks").rmdir()
        (work.folder / "blocks").symlink_to(tmp_path / "mine")
        with pytest.raises(BadInput, match="blocks: is a link"):
            work.write_block("k", BLOCK)
        work.begin("b")
        work.write_block("k", BLOCK)
    (tmp_path / "w" / LOCK).symlink_to(tmp_path / "mine" / "a")
    with pytest.raises(BadInput, match="cannot be written"):
        WorkFolder(tmp_path / "w").__enter__()
    assert [(p.name, p.read_text()) for p in (tmp_path / "mine").iterdir()] == [("a", "x")]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes with names")
def test_pipes_are_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "irpso-work")
    with pytest.raises(BadInput, match="is not a file"):
        npz_archive.load(tmp_path / "irpso-work")
    with pytest.raises(BadInput, match="is not a file"):
        npz_archive.fingerprint(files=[tmp_path / "irpso-work"])
    assert WorkFolder(tmp_path).fingerprint() is None


def test_leftovers_of_the_dead_alone_are_removed(tmp_path):
    dead = tmp_path / f"{PART}00000000-a.npz"
    dead.write_bytes(b"x")
    with replacing(tmp_path / "b") as living:
        living.write_bytes(b"b")
        remove_leftovers(tmp_path)
        assert not dead.exists() and living.exists()
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == {"b": b"b"}


@pytest.mark.skipif(sys.platform != "linux", reason="locks of bytes of open files")
def test_a_lock_keeps_nobody_from_the_bytes_of_the_file(tmp_path):
    """Shares of SMB refuse the locked bytes to every other handle: none of these may be a byte that is used."""
    import fcntl

    with FolderLock(tmp_path):
        other = os.open(tmp_path / LOCK, os.O_RDWR)
        fcntl.lockf(other, fcntl.LOCK_EX | fcntl.LOCK_NB, _FAR, 0)
        fcntl.lockf(other, fcntl.LOCK_EX | fcntl.LOCK_NB, 0, _FAR + 1)  # to the end of all
        fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)  # there, a lock of all bytes
        with pytest.raises(BlockingIOError):
            fcntl.lockf(other, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, _FAR)
        os.close(other)  # would end a lock of the process
        with pytest.raises(BadInput, match="another irpso"):
            FolderLock(tmp_path).__enter__()


def test_who_cannot_be_read_is_still_told_of(tmp_path, monkeypatch):
    def refused(*_: object) -> bytes:
        raise PermissionError(13, "Permission denied")

    with FolderLock(tmp_path), monkeypatch.context() as patched:
        patched.setattr(os, "read", refused)
        with pytest.raises(BadInput, match="another irpso is working there; wait, or choose another folder"):
            FolderLock(tmp_path).__enter__()


@pytest.mark.parametrize("kind", ["exr", "png", "tiff"])
@pytest.mark.parametrize(("size", "two"), [(256, False), (200, True)])
def test_merged_maps_have_the_bytes_of_whole_ones(tmp_path, kind, size, two):
    whole = maps(size, two)
    cut = layers(whole)
    blocks = {w.key: {name: a[w.y:w.y + w.shape[0], w.x:w.x + w.shape[1]] for name, a in cut.items()}
              for w in all_blocks(size, [1001, 1002], block=64)}
    (tmp_path / "b").mkdir()
    expected = write_maps(whole, "a/b", tmp_path / "a", kind)
    found = merge(blocks.__getitem__, all_blocks(size, [1001], block=64),
                  Target(tmp_path / "b", "a/b", kind, list(cut)))
    assert [p.name for p in found] == [p.name for p in expected] == sorted(os.listdir(tmp_path / "b"), key=[
        p.name for p in expected].index)
    for a, b in zip(expected, found, strict=True):
        assert hashlib.sha256(a.read_bytes()).digest() == hashlib.sha256(b.read_bytes()).digest(), a.name
    pair = all_blocks(size, [1001, 1002], block=64)
    udims = merge(blocks.__getitem__, pair, Target(tmp_path / "b", "o", kind, ["roughness"], tiled=True))
    assert [p.name for p in udims] == [f"o_roughness.1001.{kind}", f"o_roughness.1002.{kind}"]
    assert udims[1].read_bytes() == expected[1].read_bytes()


def test_a_merge_that_fails_leaves_nothing(tmp_path):
    def read(key: str) -> dict[str, np.ndarray]:
        if "x00000" in key and "y00000" in key:
            raise BadInput("block: gone")
        return {"roughness": np.zeros((64, 64), np.float32)}

    with pytest.raises(BadInput, match="block: gone"):
        merge(read, all_blocks(128, [1001], block=64), Target(tmp_path, "o", "exr", ["roughness"]))
    with pytest.raises(BadInput, match="does not hold 'error'"):
        merge(read, all_blocks(128, [1001], block=64), Target(tmp_path, "o", "exr", ["error"]))
    going = steps(lambda key: {"roughness": np.zeros((64, 64), np.float32)}, all_blocks(128, [1001], block=64),
                  Target(tmp_path, "o", "exr", ["roughness"]))
    assert next(going) == 0.5
    going.close()  # as when the user stops it
    assert list(tmp_path.iterdir()) == []


def test_what_lies_in_a_folder_is_told_without_a_lock(tmp_path):
    folder = tmp_path / "work"
    assert (WorkFolder.has_plan(folder), WorkFolder.count_blocks(folder)) == (False, 0)
    with WorkFolder(folder) as place:
        place.begin("a")
        place.write_block("1001_0_0", {"a": np.zeros((1, 1), np.float32)})
        (folder / "blocks" / f"{PART}00000000-1001_0_1.npz").touch()
        assert (WorkFolder.has_plan(folder), WorkFolder.count_blocks(folder)) == (False, 1)
        place.write_plan(solution())
        assert WorkFolder.has_plan(folder)
