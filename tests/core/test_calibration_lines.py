"""What a user reads of lamps and exposures that were put right."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from irpso_addon.core.change_records import (
    AmbientChange,
    BlackLevelChange,
    Calibration,
    ExposureChange,
    LampChange,
    PredictionError,
    ResponseChange,
    SizeChange,
    WorldChange,
)
from irpso_addon.core.checks.calibration_lines import (
    balance_row,
    calibrated,
    exposure_row,
    gain_of,
    lamp_name,
    lamp_rows,
    place_change,
    power_change,
    size_row,
    sure_lamps,
    tint_change,
    world_rows,
    worlds_in_doubt,
)

KEY = LampChange(("Key",), (0.03, 0.0, -0.04), (0.002,) * 3, 0.0123, 0.914, 0.003)
RIM = replace(KEY, lights=("Rim",), offset=(0.0, 0.006, 0.0), share=0.003, power=1.05)
SUN = replace(KEY, lights=("Sun",), offset=(0.02, 0.0, 0.0), share=0.02, sun=True, sure_power=False)
FLASH = replace(KEY, lights=("Flash A", "Flash B"), cameras=("A", "B"))
VIEW = ExposureChange(Path("refs/a.exr"), "A", 0.05, 0.01)
BLUE = ExposureChange(Path("refs/b.exr"), "A", 0.0, 0.01, False, (0.95, 0.99, 1.063), 0.002, True)
WORLD = WorldChange("Room", 0.0, math.radians(3.14), math.radians(0.21), 1.082, 0.003, True, False)
UNSURE = {"sure_place": False, "sure_power": False}
WARM = LampChange(("Warm",), (0.0,) * 3, (0.0,) * 3, 0.0, 1.0, 0.0, **UNSURE,
                  tint=(1.104, 1.01, 0.897), tint_error=0.002, sure_tint=True)
END = (" The error on left-out views fell from 4.3 % to 3.8 % of their radiance. "
       "The scene keeps its lamps and exposures.")


def found(*lamps: LampChange, exposures: tuple[ExposureChange, ...] = (), **more: Any) -> Calibration:
    return Calibration(lamps, exposures, PredictionError(0.0432, 2.0), PredictionError(0.0379, 1.5), **more)


@pytest.mark.parametrize(("calibration", "line"), [
    (found(KEY), "IRPSO moved 'Key' by 1.2 % of its distance and changed its power by -8.6 %."),
    (found(RIM, KEY),
     "IRPSO moved 2 lamps by up to 1.2 % of their distance ('Key') and changed their power by up to -8.6 % ('Key')."),
    (found(replace(RIM, sure_power=False), KEY, FLASH),
     "IRPSO moved 3 lamps by up to 1.2 % of their distance ('Key') and changed the power of 2 lamps by up to -8.6 % "
     "('Key')."),
    (found(replace(KEY, sure_power=False)), "IRPSO moved 'Key' by 1.2 % of its distance."),
    (found(replace(KEY, sure_place=False)), "IRPSO changed the power of 'Key' by -8.6 %."),
    (found(WARM), "IRPSO changed the colour of 'Warm' by up to -10.3 %."),
    (found(replace(WARM, lights=("Lamp",), tint=(1.0, 0.98, 1.02)), WARM),
     "IRPSO changed the colours of 2 lamps by up to -10.3 % ('Warm')."),
    (found(FLASH), "IRPSO moved the flash on 2 cameras by 1.2 % of its distance and changed its power by -8.6 %."),
    (found(SUN), "IRPSO turned 'Sun' by 1.1 degrees."),
    (found(exposures=(VIEW,)), "IRPSO changed the exposure of 'a.exr' by +0.05 EV."),
    (found(exposures=(BLUE,)),
     "IRPSO matched the white balance of 'b.exr' to the typical view's, by up to +6.3 %."),
    (found(exposures=(VIEW, BLUE, replace(BLUE, image=Path("c.exr"), tint=(0.93, 1.0, 1.05)))),
     "IRPSO changed the exposure of 'a.exr' by +0.05 EV and matched the white balance of 2 views to the typical "
     "view's, by up to -7.0 % ('c.exr')."),
    (found(replace(SUN, share=0.01), SUN, replace(KEY, sure_power=False),
           exposures=(VIEW, replace(VIEW, image=Path("b.exr"), stops=-0.12))),
     "IRPSO moved 'Key' by 1.2 % of its distance, turned 2 suns by up to 1.1 degrees ('Sun') and changed the exposure "
     "of 2 views by up to -0.12 EV ('b.exr')."),
    (found(ambient=AmbientChange((0.1, 0.1, 0.1), 0.052, 0.001)),
     "IRPSO subtracted ambient light of 5.2 % of the lamps' irradiance."),
    (found(black_level=BlackLevelChange((0.0021, 0.0019, 0.0023), 0.0001)),
     "IRPSO subtracted a black level of 0.0021 from all files."),
    (found(KEY, size=SizeChange(("Key", "Rim"), 0.47, 0.05, 0.01)),
     "IRPSO changed the width of the lamps from 20 mm to 0.94 m, moved 'Key' by 1.2 % of its distance and changed its "
     "power by -8.6 %."),
    (found(size=SizeChange(("Sun",), 0.05, 0.005, 0.0, True)),
     "IRPSO changed the angle of the suns from 0.0° to 5.7°."),
    (found(response=ResponseChange(1.613, 0.01, 8.26, 0.05)),
     "IRPSO undid a tone curve of exponent 1.61 and shoulder 8.3, because the files have one."),
    (found(KEY, response=ResponseChange(0.954, 0.001)),
     "IRPSO moved 'Key' by 1.2 % of its distance, changed its power by -8.6 % and undid a response of exponent 0.954, "
     "because the files are not linear."),
    (found(replace(KEY, **UNSURE)), "IRPSO changed lamps a little, although no single change is certain."),
    (found(exposures=(replace(VIEW, sure=False),)),
     "IRPSO changed exposures a little, although no single change is certain."),
    (found(replace(KEY, **UNSURE), exposures=(replace(VIEW, sure=False),)),
     "IRPSO changed lamps and exposures a little, although no single change is certain."),
])
def test_the_line(calibration: Calibration, line: str) -> None:
    """Who did what, one idea a sentence, whatever was changed."""
    assert calibrated(calibration) == (line + END,)


def test_errors_that_read_alike_are_left_out() -> None:
    """The root mean square of few large errors may hide what most views gain."""
    alike = replace(found(KEY), changed=PredictionError(0.0431, 1.5))
    assert calibrated(alike) == ("IRPSO moved 'Key' by 1.2 % of its distance and changed its power by -8.6 %. "
                                 "The scene keeps its lamps and exposures.",)


def test_nothing_to_say() -> None:
    assert calibrated(None) == ()


def test_the_row_of_a_size() -> None:
    """Widths, of suns angles, as Blender states them."""
    assert size_row(found(size=SizeChange(("Key",), 0.47, 0.05, 0.01))) == ("Lamps' Width", "0.94 ± 0.10 m")
    assert size_row(found(size=SizeChange(("Key",), 0.024, 0.002, 0.0))) == ("Lamps' Width", "48 ± 4 mm")
    assert size_row(found(size=SizeChange(("Sun",), 0.05, 0.005, 0.0, True))) == ("Suns' Angle", "5.7 ± 0.6°")
    assert size_row(found(KEY)) is None


def test_figures() -> None:
    assert place_change(KEY) == "50 ± 2 mm" and place_change(RIM) == "6.0 ± 2.0 mm"
    assert place_change(SUN) == f"{math.degrees(0.02):.1f} ± 0.1°"
    assert power_change(KEY) == "× 0.914 ± 0.3 %"
    assert lamp_name(FLASH) == "the flash on 2 cameras" and gain_of(found()) == "4.3 % → 3.8 %"


def test_rows_of_the_panel() -> None:
    """The farthest first; what is within doubt is left out."""
    calibration = found(RIM, WARM, replace(SUN, **UNSURE), KEY, FLASH, exposures=(VIEW, replace(VIEW, stops=-0.12)))
    key, flash, rim, warm = (lamp_rows(lamp) for lamp in sure_lamps(calibration))
    assert key == [("Key", "50 ± 2 mm"), ("Power", "× 0.914 ± 0.3 %")]
    assert [rows[0][0] for rows in (flash, rim)] == ["Flash on 2 cameras", "Rim"]
    colors = [("Red", "× 1.104 ± 0.2 %"), ("Green", "× 1.010 ± 0.2 %"), ("Blue", "× 0.897 ± 0.2 %")]
    assert warm == [("Warm", "place as given"), *colors]
    both = lamp_rows(replace(KEY, tint=WARM.tint, tint_error=0.002, sure_tint=True))
    assert both == [*key, *colors] and tint_change(WARM) == "RGB × 1.10 1.01 0.90"
    assert exposure_row(calibration) == ("2 Exposures", "up to -0.12 EV", "a.exr")
    assert exposure_row(found(exposures=(replace(VIEW, sure=False),))) is None
    assert balance_row(calibration) is exposure_row(found(exposures=(BLUE,))) is None
    assert balance_row(found(exposures=(VIEW, BLUE))) == ("1 White Balance", "RGB × 0.95 0.99 1.06", "b.exr")
    assert balance_row(found(exposures=(BLUE, BLUE))) == ("2 White Balances", "up to RGB × 0.95 0.99 1.06", "b.exr")


@pytest.mark.parametrize(("worlds", "line"), [
    ((WORLD,), "IRPSO turned world 'Room' by +3.1 degrees."),
    ((replace(WORLD, sure_strength=True),),
     "IRPSO turned world 'Room' by +3.1 degrees and changed the strength of world 'Room' by +8.2 %."),
    ((WORLD, replace(WORLD, given=1.0, turn=-0.1), replace(WORLD, given=2.0, sure_turn=False)),
     "IRPSO changed 2 turns of world 'Room' by up to -5.7 degrees."),
])
def test_worlds(worlds: tuple[WorldChange, ...], line: str) -> None:
    end = END.replace("lamps and exposures", "world and the views' turns")
    assert calibrated(found(worlds=worlds)) == (line + end,)


def test_a_change_of_worlds_that_was_not_made() -> None:
    (line,) = worlds_in_doubt(found(worlds=(WORLD, replace(WORLD, world="Hall", turn=-0.1))))
    assert "if IRPSO turned world 'Room' by +3.1 degrees and turned world 'Hall' by -5.7 degrees, but" in line
    assert worlds_in_doubt(None) == ()


def test_rows_of_worlds() -> None:
    assert world_rows(found(worlds=(WORLD,))) == [("Room", "+3.1 ± 0.2°")]
    both = found(worlds=(replace(WORLD, sure_strength=True), replace(WORLD, turn=0.2)))
    assert world_rows(both) == [("Room", "up to +11.5 ± 0.2°"), ("Strength of Room", "× 1.082 ± 0.3 %")]
    assert world_rows(found()) == []


def test_an_error_that_did_not_fall_is_not_said_to_have_fallen():
    (line,) = calibrated(replace(found(KEY), changed=PredictionError(0.0455, 1.5)))
    assert "fell" not in line and line.endswith("The scene keeps its lamps and exposures.")
