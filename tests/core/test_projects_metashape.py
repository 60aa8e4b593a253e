"""Metashape's XML against the projection in its manual."""

from __future__ import annotations

import math

import numpy as np
import pytest

from irpso_addon.core.shoot.project_file import read_project
from tests.support.project_checks import AROUND, PIXEL, POINTS, WIDE, agrees, refused, seen
from tests.support.project_files import Shot, ring, similarity, write_metashape


def metashape_pixel(shot: Shot, point: np.ndarray, lens=WIDE, size=(8688, 5792), fisheye=False) -> tuple[float, float]:
    """By the appendix of Metashape's manual, letter for letter; ``point`` in the camera's own coordinates."""
    X, Y, Z = shot.rotation.T @ (point - shot.place)
    x, y = X / Z, Y / Z
    if fisheye:
        r0 = math.sqrt(x * x + y * y)
        x, y = x * math.atan(r0) / r0, y * math.atan(r0) / r0
    r = math.sqrt(x * x + y * y)
    K = [lens.get(f"k{n}", 0.0) for n in (1, 2, 3, 4)]
    P1, P2 = lens.get("p1", 0.0), lens.get("p2", 0.0)
    xp = x * (1 + K[0] * r**2 + K[1] * r**4 + K[2] * r**6 + K[3] * r**8) + (P1 * (r**2 + 2 * x**2) + 2 * P2 * x * y)
    yp = y * (1 + K[0] * r**2 + K[1] * r**4 + K[2] * r**6 + K[3] * r**8) + (P2 * (r**2 + 2 * y**2) + 2 * P1 * x * y)
    return (size[0] * 0.5 + lens["cx"] + xp * lens["f"] + xp * lens.get("b1", 0.0) + yp * lens.get("b2", 0.0),
            size[1] * 0.5 + lens["cy"] + yp * lens["f"])


@pytest.mark.parametrize("kind", ["frame", "fisheye", "equidistant_fisheye"])
def test_metashape_projects_as_its_manual_says(tmp_path, kind):
    shots = ring(5, suffix="")
    path = write_metashape(tmp_path / "cameras.xml", shots, WIDE, kind=kind)
    project = read_project(path)
    agrees(project, shots, lambda shot, point: metashape_pixel(shot, point, fisheye=kind != "frame"))
    assert (project.kind, project.left_out, project.warnings) == ("Metashape", (), ())
    assert project.metres_per_unit is None
    assert (project.cameras[0].lens.width, project.cameras[0].lens.height) == (8688, 5792)


@pytest.mark.parametrize("where", ["chunk", "component", "group", "both"])
def test_metashape_chunk_and_component_lead_to_the_world(tmp_path, where):
    shots, translation, scale = ring(4), np.array([3.0, -2.0, 0.5]), 0.25
    inner = similarity(AROUND, translation, scale)
    component = f'<components next_id="1" active_id="0"><component id="0"><transform>{inner}</transform></component>' \
                "</components>"
    if where == "group":
        component = component.replace("<component ", '<group id="3"><component ').replace(
            "</components>", "</group></components>")
    path = write_metashape(
        tmp_path / "c.xml", shots, WIDE, attributes='component_id="0"', reference='LOCAL_CS["x",UNIT["metre",1]]',
        chunk=inner if where in ("chunk", "both") else None, components=component if where != "chunk" else "")
    project = read_project(path)
    world = scale * POINTS @ AROUND.T + translation
    for camera, shot in zip(project.cameras, shots, strict=True):
        assert np.abs(seen(camera, world) - [metashape_pixel(shot, point) for point in POINTS]).max() < PIXEL
    assert project.metres_per_unit == 1.0


@pytest.mark.parametrize(("reference", "metres", "warned"), [
    ('LOCAL_CS["Local",LOCAL_DATUM["d",0],UNIT["millimetre",0.001,AUTHORITY["EPSG","1025"]]]', 0.001, False),
    ("", 1.0, False), ('GEOGCS["WGS 84",DATUM["x"],UNIT["degree",0.0174]]', 1.0, True),
])
def test_metashape_states_its_unit(tmp_path, reference, metres, warned):
    path = write_metashape(tmp_path / "c.xml", ring(3), WIDE, reference=reference,
                           chunk=similarity(np.eye(3), np.zeros(3), 1.0))
    project = read_project(path)
    assert project.metres_per_unit == metres and ("geographic" in "".join(project.warnings)) == warned


def test_metashape_leaves_out_what_has_no_pose(tmp_path):
    more = ('<camera id="90" sensor_id="0" label="loose"/><camera id="91" sensor_id="0" label="slave" master_id="0"/>'
            '<group id="0"><camera id="92" sensor_id="0" label="off" enabled="false"><transform>1</transform></camera>'
            '</group><camera id="93" sensor_id="0" component_id="1" label="stray"><transform>1</transform></camera>')
    components = ('<components active_id="0"><component id="0"><transform>'
                  f'{similarity(AROUND, np.zeros(3), 2.0)}</transform></component><component id="1"/></components>')
    project = read_project(write_metashape(tmp_path / "c.xml", ring(2), WIDE, more=more, components=components,
                                           attributes='component_id="0"'))
    assert len(project.cameras) == 2
    left = dict(project.left_out)
    assert {name: why.split(";")[0].split(" ")[0:4] for name, why in left.items()} == {
        "loose": ["it", "is", "not", "aligned"], "slave": ["it", "is", "a", "slave"],
        "off": ["it", "is", "disabled", "in"], "stray": ["its", "component", "has", "no"]}


def test_metashape_leaves_out_pictures_of_sensors_that_cannot_be_used(tmp_path):
    """A panorama of the room among the pictures of the object."""
    path = write_metashape(tmp_path / "c.xml", ring(3), WIDE, more=(
        '<camera id="90" sensor_id="7" label="room"><transform>1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</transform></camera>'))
    sensor = '<sensor id="7" type="spherical"><resolution width="8000" height="4000"/></sensor></sensors>'
    path.write_text(path.read_text(encoding="utf-8").replace("</sensors>", sensor), encoding="utf-8")
    project = read_project(path)
    assert len(project.cameras) == 3 and [name for name, _ in project.left_out] == ["room"]
    assert project.left_out[0][1].startswith("its sensor is of type 'spherical', and only frame")


@pytest.mark.parametrize(("content", "why"), [
    ('<resolution width="60" height="40"/>', "its sensor has no calibration; align these pictures too"),
    ('<resolution width="60" height="40"/><calibration type="frame"><fx>9</fx></calibration>', "has no f"),
    ('<calibration type="frame"><f>9</f></calibration>', "its sensor has no resolution"),
    ('<resolution width="60" height="40"/><calibration type="frame"><f>9</f><p3>1</p3></calibration>', "p3 and p4"),
])
def test_metashape_leaves_out_pictures_of_sensors_without_a_lens(tmp_path, content, why):
    """Two of another camera that have a pose, between those of the first: they are named, and the others stay."""
    more = "".join(f'<camera id="{n}" sensor_id="7" label="phone {n}"><transform>1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1'
                   "</transform></camera>" for n in (90, 91))
    path = write_metashape(tmp_path / "c.xml", ring(3), WIDE, more=more)
    sensor = f'<sensor id="7" type="frame">{content}</sensor></sensors>'
    path.write_text(path.read_text(encoding="utf-8").replace("</sensors>", sensor), encoding="utf-8")
    project = read_project(path)
    assert len(project.cameras) == 3 and [name for name, _ in project.left_out] == ["phone 90", "phone 91"]
    assert all(why in each and "; " in each for _, each in project.left_out)


@pytest.mark.parametrize(("parts", "calibration", "words"), [
    ({"kind": "spherical"}, WIDE, ["IMG_0000", "spherical"]),
    ({"kind": "equisolid_fisheye"}, WIDE, ["equisolid_fisheye"]),
    ({}, {"fx": 1.0, "cx": 4000.0}, ["has no f"]), ({}, WIDE | {"p3": 0.1}, ["p3"]),
    ({}, WIDE | {"f": 0.0, "b1": 0.0}, ["focal length of 0"]), ({}, WIDE | {"k1": float("nan")}, ["IMG_0000", "k1"]),
    ({"size": (0, 100)}, WIDE, ["0 x 100"]), ({"size": (4, 1e9)}, WIDE, ["pixels"]),
    ({"sensor": '<sensor id="5" type="frame"/>'}, WIDE, ["no calibration"]),
    ({"chunk": "<scale>-1</scale>"}, WIDE, ["scale -1"]),
    ({"chunk": "<rotation>1 0 0</rotation>"}, WIDE, ["3 numbers"]),
    ({"chunk": similarity(2 * np.eye(3), np.zeros(3), 1.0)}, WIDE, ["IMG_0000", "not a rotation"]),
])
def test_metashape_refuses(tmp_path, parts, calibration, words):
    refused(write_metashape(tmp_path / "c.xml", ring(2), calibration, **parts), *words)


@pytest.mark.parametrize(("text", "words"), [
    ("<html><body/></html>", "Export Cameras"), ("<document/>", "not a Metashape project"),
    ("<document><chunk/></document>", "not a Metashape project"), ("<document>", "not complete XML"),
    ("<document><chunk><cameras/></chunk></document>", "align"), ("<", "not complete XML"),
    ("<document><chunk/><chunk/></document>", "2 chunks"), ("<a>" * 1000, "deeper"),
    ('<!DOCTYPE a [<!ENTITY b "bbbbbbbbbb"><!ENTITY c "&b;&b;&b;&b;&b;&b;&b;&b;&b;&b;">]><a>&c;</a>', "document type"),
    ('<!DOCTYPE a SYSTEM "file:///etc/hostname"><document/>', "document type"),
])
def test_other_xml_is_refused(tmp_path, text, words):
    path = tmp_path / "c.xml"
    path.write_text(text)
    refused(path, words)
