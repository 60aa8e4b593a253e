"""``--calibrate``: one flag for all that a solve may correct."""

from __future__ import annotations

import pytest

from irpso_addon.cli import options
from irpso_addon.core.params import SolveSettings


def settings(*flags: str) -> dict[str, str]:
    asked = options.settings(options.parser().parse_args(["solve", "a.blend", *flags]))
    return {name: getattr(asked, name) for name in ("lamps", "registration", "exposures", "normals")}


ALL = {"lamps": "auto", "registration": "auto", "exposures": "auto", "normals": "auto"}
NONE = {"lamps": "given", "registration": "given", "exposures": "given", "normals": "mesh"}


@pytest.mark.parametrize(("flags", "wanted"), [
    ([], ALL),
    (["--calibrate", "auto"], ALL),
    (["--calibrate", "off"], NONE),
    (["--calibrate", "lamps,normals"], NONE | {"lamps": "auto", "normals": "auto"}),
    (["--calibrate", "cameras"], NONE | {"registration": "auto"}),
    (["--calibrate", "off", "--exposures", "solve"], NONE | {"exposures": "solve"}),
    (["--exposures", "solve", "--calibrate", "lamps"], NONE | {"lamps": "auto"}),
])
def test_what_may_be_corrected(flags: list[str], wanted: dict[str, str]) -> None:
    assert settings(*flags) == wanted
    for name, value in wanted.items():
        assert value in [key for key, _ in SolveSettings.__dataclass_fields__[name].metadata["choices"]]


@pytest.mark.parametrize("text", ["lights", "lamps,", "Lamps", ""])
def test_what_is_not_known(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        settings("--calibrate", text)
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert "is not known; choose auto, off, or some of lamps,cameras,exposures,normals" in said
