"""captures.json: the contract, and that nothing malformed gets through or out as anything but one line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from irpso_addon.core.capture.captures import CaptureView, parse_captures, read_captures
from irpso_addon.core.errors import BadInput

FILE = Path("shoot") / "captures.json"
VIEW = {"image": "refs/a.exr", "camera": "Cam", "lights": ["Key"]}

names = st.text(st.characters(exclude_categories=["Cc", "Cs"]), min_size=1).filter(str.strip)
views = st.fixed_dictionaries(
    {"image": names, "camera": names, "lights": st.lists(names, max_size=4, unique=True)},
    optional={"exposure": st.floats(-64, 64), "mask": names, "colorspace": names, "made by": st.integers()},
)
json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
)


def error_of(content: object) -> str:
    with pytest.raises(BadInput) as caught:
        parse_captures(content if isinstance(content, str) else json.dumps(content), FILE)
    message = str(caught.value)
    assert "\n" not in message and message.startswith(str(FILE))
    return message


@given(st.lists(views, min_size=1, max_size=3).filter(
    lambda found: found[0] not in found[1:] and found[-1] not in found[:-1]))
def test_reads_back_what_was_written(entries):
    found = parse_captures(json.dumps({"views": entries, "version": 3}), FILE)
    assert found == [
        CaptureView(
            image=FILE.parent / e["image"], camera=e["camera"], lights=tuple(e["lights"]),
            exposure=e.get("exposure", 0.0), mask=FILE.parent / e["mask"] if "mask" in e else None,
            colorspace=e.get("colorspace"), world=e.get("world"), turn=e.get("turn", 0.0),
        )
        for e in entries
    ]


@given(st.text() | json_values.map(json.dumps))
def test_anything_else_is_bad_input_and_nothing_worse(text):
    error_of(text)


@given(views, st.sampled_from(["image", "camera", "lights", "exposure", "mask", "colorspace", "world", "turn"]),
       json_values)
def test_any_value_under_any_key_is_read_or_bad_input(entry, key, value):
    try:
        [view] = parse_captures(json.dumps({"views": [entry | {key: value}]}), FILE)
    except BadInput as error:
        assert "\n" not in str(error) and "view 0" in str(error)
    else:
        assert -64 <= view.exposure <= 64 and abs(view.turn) <= 3600 and view.camera.strip()


@pytest.mark.parametrize(("change", "words"), [
    ({"image": None}, '"image" is missing'),
    ({"camera": 3}, '"camera" is not a name'),
    ({"camera": "a\nb"}, '"camera" is not a name'),
    ({"lights": None}, '"lights" is missing'),
    ({"lights": "Key"}, '"lights" is missing'),
    ({"turn": "left"}, '"turn" is not a number'),
    ({"vignetting": "4"}, '"vignetting" is not a number'),
    ({"vignetting": 17}, 'between -16 and 16 powers of the cosine'),
    ({"response": "sRGB"}, '"response" is not a number'),
    ({"response": 0.1}, 'between 0.2 and 5'),
    ({"response": 6}, '"response" is out of range; it must be between 0.2 and 5'),
    ({"shoulder": 0.5}, '"shoulder" is out of range; it must be between 1 and 1000'),
    ({"black_level": 0.1}, '"black_level" is not a color'),
    ({"black_level": [0, 0, 1.5]}, 'each between -1 and 1'),
    ({"tint": 1.1}, '"tint" is not a color'),
    ({"tint": [1, 1, 0]}, 'each between 0.1 and 10'),
    ({"ambient_radiance": 0.1}, '"ambient_radiance" is not a color'),
    ({"ambient_radiance": [0.1, 0.1]}, '"ambient_radiance" is not a color'),
    ({"ambient_radiance": [0.1, -0.1, 0]}, 'each between 0 and 1e+06'),
    ({"ambient_radiance": [0, 0, 10**400]}, 'each between 0 and 1e+06'),
    ({"turn": 1e9}, '"turn" is out of range'),
    ({"world": 3}, '"world" is not a name'),
    ({"lights": ["Key", 2]}, "not a name"),
    ({"lights": ["Key", "Key"]}, "twice"),
    ({"exposure": "bright"}, "not a number"),
    ({"exposure": True}, "not a number"),
    ({"exposure": float("nan")}, "out of range"),
    ({"exposure": float("-inf")}, "out of range"),
    ({"exposure": 10**400}, "out of range"),
    ({"mask": 0}, '"mask" is not a name'),
])
def test_names_the_view_and_what_is_wrong(change, words):
    message = error_of({"views": [VIEW, VIEW | change]})
    assert "view 1" in message and words in message


@pytest.mark.parametrize("content", ["", "{", "[]", "null", "{}", '{"views": []}', '{"views": {}}', "[" * 100_000])
def test_no_views(content):
    error_of(content)


def test_a_view_that_is_listed_twice_is_refused():
    one, two = ({"image": name, "camera": "Camera", "lights": ["Key"]} for name in ("a.exr", "b.exr"))
    with pytest.raises(BadInput, match=r"c\.json: view 2: is the same as view 0; list it once"):
        parse_captures(json.dumps({"views": [one, two, one]}), Path("c.json"))


def test_broken_json_names_the_line():
    assert "line 2" in error_of('{"views": [\n,]}')


def test_files(tmp_path):
    path = tmp_path / "c.json"
    for spoil in (lambda: None, lambda: path.write_bytes(b"\xff\xfe\x00"), lambda: (path.unlink(), path.mkdir())):
        spoil()
        with pytest.raises(BadInput, match=r"c\.json: "):
            read_captures(path)
    path.rmdir()
    path.write_bytes(b"\xef\xbb\xbf" + json.dumps({"views": [VIEW]}).encode())  # a byte order mark, as Windows writes
    assert read_captures(path)[0].image == tmp_path / "refs" / "a.exr"
