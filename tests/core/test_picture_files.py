"""Which file is which picture: folders made here, and what a reader of the rule would choose."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from irpso_addon.core.errors import BadInput
from irpso_addon.core.shoot.picture_files import PictureFiles, PictureFolder


def made(folder: Path, *names: str) -> PictureFolder:
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    return PictureFolder(folder)


def found(folder: Path, names: list[str], *files: str) -> tuple[dict[str, str], dict[str, str], PictureFiles]:
    match = made(folder, *files).match(names)
    inside = [{name: path.relative_to(folder).as_posix() for name, path in paths.items()}
              for paths in (match.files, match.masks)]
    return inside[0], inside[1], match


@pytest.mark.parametrize(("name", "files", "want"), [
    ("IMG_1.jpg", ["IMG_1.jpg", "IMG_10.jpg"], "IMG_1.jpg"),
    ("img_1.JPG", ["IMG_1.jpg"], "IMG_1.jpg"),
    ("IMG_1", ["IMG_1.tif"], "IMG_1.tif"),
    ("a.b.1", ["a.b.1.tif", "a.b.tif"], "a.b.1.tif"),  # Metashape's labels have no suffix, and dots are none
    ("IMG_1.jpg", ["IMG_1.jpg", "IMG_1.CR3"], "IMG_1.CR3"),
    ("IMG_1.jpg", ["IMG_1.jpg", "developed/IMG_1.tif"], "developed/IMG_1.tif"),
    ("right/IMG_1.jpg", ["left/IMG_1.jpg", "right/IMG_1.jpg"], "right/IMG_1.jpg"),
    ("C:\\shoot\\right\\IMG_1.jpg", ["left/IMG_1.jpg", "right/IMG_1.jpg"], "right/IMG_1.jpg"),
    ("right/IMG_1.jpg", ["left/IMG_1.CR3", "right/IMG_1.jpg"], "right/IMG_1.jpg"),  # folders come before kinds
    ("IMG_1.jpg", ["IMG_1.jpg", "IMG_1.jpeg"], "IMG_1.jpg"),
    ("IMG_1", ["images/IMG_1.jpg", "Masks/IMG_1.png"], "images/IMG_1.jpg"),  # of those alike, PNG would come first
    ("IMG_1", ["masks/IMG_1.png", "masks/IMG_1.CR3"], "masks/IMG_1.CR3"),  # pictures of masks
    ("IMG_1", ["masks/front/IMG_1.png"], "masks/front/IMG_1.png"),
    ("IMG_1.jpg", ["IMG_1.jpg", ".thumbnails/IMG_1.jpg", "._IMG_1.jpg"], "IMG_1.jpg"),
    ("S\u00fcd/\u00c4_1.jpg", ["Nord/A\u0308_1.jpg", "Su\u0308d/A\u0308_1.jpg"], "Su\u0308d/A\u0308_1.jpg"),  # a Mac's
])
def test_the_file_of_a_picture(tmp_path, name, files, want):
    assert found(tmp_path, [name], *files)[0] == {name: want}


@pytest.mark.parametrize(("picture", "files", "want"), [
    ("a/1.jpg", ["a/1.jpg", "a/1_mask.png"], "a/1_mask.png"),
    ("a/1.jpg", ["a/1.jpg", "b/1.jpg", "a/1_mask.png", "b/1_mask.png"], "a/1_mask.png"),
    ("b/1.jpg", ["a/1.jpg", "b/1.jpg", "a/1_mask.png", "b/1_mask.png"], "b/1_mask.png"),
    ("b/1.jpg", ["a/1.jpg", "b/1.jpg", "masks/a/1_mask.png", "masks/b/1_mask.png"], "masks/b/1_mask.png"),
    ("a/1.jpg", ["a/1.jpg", "a/11_mask.png"], None),
    ("a/1.jpg", ["a/1.jpg", "a/1-MASK.PNG"], "a/1-MASK.PNG"),
    ("1", ["images/1.jpg", "masks/1.png"], "masks/1.png"),
    ("1.jpg", ["images/1.jpg", "masks/1.jpg.png", "masks/11.jpg.png"], "masks/1.jpg.png"),
    ("b/1.jpg", ["images/a/1.jpg", "images/b/1.jpg", "mask/a/1.png", "mask/b/1.png"], "mask/b/1.png"),
    ("1.jpg", ["1.jpg", "1_mask.png", "masks/1.png"], "1_mask.png"),
    ("1.jpg", ["1.jpg", "depth/1.png"], None),
])
def test_the_mask_of_a_picture(tmp_path, picture, files, want):
    masks = found(tmp_path, [picture], *files)[1]
    assert masks == ({} if want is None else {picture: want})


def test_the_masks_that_a_project_states(tmp_path):
    """One of another name, one that is not there, and one beside a picture instead of the one that is not there."""
    folder = made(tmp_path / "images", "1.jpg", "2.jpg", "3.jpg", "1_mask.png", "3_mask.png", "m4.png")
    (tmp_path / "alpha.png").touch()
    stated = {"1.jpg": tmp_path / "alpha.png", "2.jpg": tmp_path / "b.png", "3.jpg": tmp_path / "c.png",
              "4.jpg": tmp_path / "images" / "m4.png"}
    match = folder.match(["1.jpg", "2.jpg", "3.jpg"], (), stated)
    assert match.masks == {"1.jpg": tmp_path / "alpha.png", "3.jpg": tmp_path / "images" / "3_mask.png"}
    assert match.lost_masks == ("2.jpg",) and match.unused == 1
    assert folder.match(["1.jpg"], (), {"1.jpg": tmp_path / "images" / "m4.png"}).unused == 2


def test_what_is_missing_and_what_is_left_over(tmp_path):
    match = found(tmp_path, ["1.jpg", "2.jpg"], "1.jpg", "1.CR3", "3.jpg", "4.jpg", "4.CR3", "notes.txt")[2]
    assert match.missing == ("2.jpg",) and match.unused == 2  # 3 and 4
    assert PictureFolder(tmp_path).match(["1.jpg"], ["C:\\shoot\\4.jpg", "5.jpg"]).unused == 1  # of those, 3


@pytest.mark.parametrize(("names", "files", "line"), [
    (["1.jpg"], ["a/1.jpg", "b/1.jpg"], r"both 'a.1\.jpg' and 'b.1\.jpg' can be the project's picture '1\.jpg'"),
    (["a/1.jpg", "b/1.jpg"], ["1.jpg"], r"1\.jpg: is the only file for two pictures of the project, 'a/1\.jpg' and 'b"),
    (["1.jpg"], ["1.jpg", "1_mask.png", "1.mask.png"], "can be its mask"),
    (["a/1.jpg"], ["1.HEIC", "2.HEIC"], r"its pictures are \.HEIC files, which cannot be read; convert"),
    (["1.jpg"], ["1.txt", "2.HEIC"], "has none of the project's pictures"),
    (["1.jpg"], ["2.jpg"], r"has none of the project's pictures \('1\.jpg'\); choose"),
])
def test_what_cannot_be_told(tmp_path, names, files, line):
    with pytest.raises(BadInput, match=line):
        found(tmp_path, names, *files)


def test_folders_that_cannot_be_read(tmp_path):
    (tmp_path / "file").touch()
    for folder in (tmp_path / "nowhere", tmp_path / "file", Path("a\0b")):
        with pytest.raises(BadInput, match="choose the folder of the pictures"):
            PictureFolder(folder)


NAMES = st.text(st.sampled_from("aB1 ._-é\\/") | st.characters(exclude_categories=("Cs",), exclude_characters="\0"),
                min_size=1, max_size=12)
PARTS = st.text(st.sampled_from("aB1 _-é."), min_size=1, max_size=5).filter(lambda text: text.strip("."))
PATHS = st.builds(lambda folders, stem, suffix: "/".join([*folders, stem + suffix]), st.lists(PARTS, max_size=2), PARTS,
                  st.sampled_from([".jpg", ".JPG", ".tif", ".cr2", ".png", "_mask.png", ".txt"]))


@settings(max_examples=100, deadline=None)
@given(NAMES | PATHS, st.lists(PATHS, max_size=6))
def test_any_name_in_any_folder(name, files):
    """One of the folder's pictures with the name's stem, or a line; what is named in full is found."""
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        there = []
        for file in files:
            try:
                made(folder, file)
                there.append(file)
            except OSError:  # a file where there is to be a folder
                pass
        listing = PictureFolder(folder)
        try:
            path = listing.find(name)
        except BadInput as error:
            assert "\n" not in str(error)
            return
        pictures = {folder / file for file in there}
        assert path is None or path in pictures
        if path is not None:
            last = name.replace("\\", "/").rstrip("/.").rsplit("/", 1)[-1].lower()
            assert last.startswith(path.stem.lower().rstrip("."))


@settings(max_examples=50, deadline=None)
@given(st.lists(PARTS.filter(lambda text: not text.endswith(".")).map(str.lower), min_size=1, max_size=6, unique=True),
       st.randoms())
def test_whole_paths_find_their_files(folders, random):
    """A project that names its pictures by folders finds each, whatever their order."""
    with tempfile.TemporaryDirectory() as text:
        names = [f"{folder}/IMG_1.jpg" for folder in folders if not folder.startswith(".")]
        listing = made(Path(text), *names)
        if not names:
            return
        random.shuffle(names)
        assert listing.match(names).files == {name: Path(text) / name for name in names}


@pytest.mark.skipif(os.name == "nt" or os.getuid() == 0, reason="needs a user whom permissions bind")
def test_a_folder_without_permission(tmp_path):
    tmp_path.chmod(0)
    try:
        with pytest.raises(BadInput, match="cannot be read"):
            PictureFolder(tmp_path)
    finally:
        tmp_path.chmod(0o700)
