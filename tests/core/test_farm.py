"""Jobs for farms: the template by the specification's own reader, tasks that cover each block once, the simulation."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest
from openjd.model import (
    DocumentType,
    StepParameterSpaceIterator,
    create_job,
    decode_job_template,
    document_string_to_object,
    preprocess_job_parameters,
)

from irpso_addon.core.data import SceneData
from irpso_addon.core.errors import BadInput
from irpso_addon.core.params import SolveSettings
from irpso_addon.core.tiled.uv_blocks import all_blocks
from irpso_addon.core.versions import version
from irpso_addon.solve import farm
from tools.farm_simulation import Costs, Work, alone, simulate

OPENJD = Path(sys.executable).with_name("openjd")
JOB = farm.Job("Vase", (1001, 1002), 4096, 2048, "exr", 2.0)


@pytest.mark.parametrize("job", [
    JOB,
    farm.Job("{{Param.Work}} 'Väse': #1\n- x", (1001,), 2048, 8192, "png", None),
    farm.Job("n" * 300, tuple(range(1001, 2000)), 8192, 512, "tiff", 0.25),
], ids=["plain", "hostile name", "as many as there may be"])
def test_template_is_valid(job: farm.Job, tmp_path: Path) -> None:
    path = tmp_path / farm.TEMPLATE
    path.write_text(farm.template(job), encoding="utf-8")
    template = decode_job_template(template=document_string_to_object(
        document=path.read_text(encoding="utf-8"), document_type=DocumentType.YAML))
    values = preprocess_job_parameters(job_template=template, job_parameter_values={}, job_template_dir=tmp_path,
                                       current_working_dir=tmp_path)
    assert {name: Path(value.value).parent for name, value in values.items() if name != "Python"} == dict.fromkeys(
        ("Program", "Work", "Maps"), tmp_path)
    made = create_job(job_template=template, job_parameter_values=values)
    steps = {step.name: len(StepParameterSpaceIterator(space=step.parameterSpace)) for step in made.steps}
    assert steps == {"Solve": len(job.udims) * job.tiles, "Merge": len(job.udims)}
    assert made.name.startswith("IRPSO ") and len(made.name) <= farm.NAME_LENGTH


@pytest.mark.parametrize("subject", ["a{{{b", "{{{{", "}}}a}}", "{}{{}}"])
def test_a_name_holds_no_reference(subject: str) -> None:
    name = farm._job_name(subject)
    assert "{{" not in name and "}}" not in name
    assert name.replace(" ", "") == f"IRPSO{subject}"


def test_check_finds_nothing(tmp_path: Path) -> None:
    path = tmp_path / farm.TEMPLATE
    path.write_text(farm.template(JOB), encoding="utf-8")
    done = subprocess.run([OPENJD, "check", path], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stdout + done.stderr


def test_only_gpu_jobs_ask_for_one() -> None:
    assert "amount.worker.gpu" in farm.template(JOB)
    assert "amount.worker" not in farm.template(farm.Job("Vase", (1001,), 4096, 2048, "exr", None))


@pytest.mark.parametrize("size", [64, 512, 1000, 4096])
@pytest.mark.parametrize("tile", [512, 2048, 8192])
def test_tasks_cover_each_block_once(size: int, tile: int) -> None:
    job = farm.Job("Vase", (1001, 1012), size, tile, "exr", None)
    whole = all_blocks(size, job.udims)
    found = Counter(w.key for udim in job.udims for n in range(job.tiles)
                    for w in farm.blocks_of(whole, udim, n, tile))
    assert found == Counter(w.key for w in whole)
    assert farm.blocks_of(whole, 1001, job.tiles, tile) == []


def test_program_runs_where_it_was_copied(tmp_path: Path) -> None:
    """In a folder with a space, from elsewhere, without Blender: it says what it lacks in one line."""
    farm.copy_program(tmp_path / "my job")
    code = f"import runpy, sys; sys.modules['bpy'] = None; sys.argv = ['', 'tile', 'no such', '--udim', '1001', " \
           f"'--tile', '0', '--tile-size', '512']; runpy.run_path({str(tmp_path / 'my job')!r}, run_name='__main__')"
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 3, done.stderr
    assert done.stderr.startswith("irpso: no such: ") and done.stderr.count("\n") == 1
    assert done.stdout.startswith("openjd_fail: no such: ")
    manifest = tmp_path / "my job" / "blender_manifest.toml"
    assert f'version = "{version()}"' in manifest.read_text()
    assert not list(tmp_path.rglob("*.blend")) and not (tmp_path / "no such").exists()


@pytest.mark.parametrize("name", ["program", "template.yaml"])
@pytest.mark.parametrize("kind", ["folder", "file", "link", "link to one of ours"])
def test_what_is_not_a_jobs_stays(tmp_path: Path, name: str, kind: str) -> None:
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "novel.txt").write_text("text")
    (mine / "__main__.py").write_text(farm.START if "ours" in kind else "print('mine')")
    (mine / "t.yaml").write_text(farm.template(JOB))
    job = tmp_path / "job"
    job.mkdir()
    if "link" in kind:
        (job / name).symlink_to(mine / "t.yaml" if name == farm.TEMPLATE else mine)
    elif kind == "folder":
        shutil.copytree(mine, job / name)
    else:
        (job / name).write_text("specificationVersion: jobtemplate-2023-09\nname: mine\n")
    before = {path: path.is_symlink() or path.is_dir() or path.read_text() for path in tmp_path.rglob("*")}
    with pytest.raises(BadInput, match=rf"job: contains a \w+ '{name}' that is not irpso's; choose another folder"):
        next(farm.plan_job(SceneData("", None, None, ()), SolveSettings(), job))
    assert {path: path.is_symlink() or path.is_dir() or path.read_text() for path in tmp_path.rglob("*")} == before


@pytest.mark.parametrize("left", ["whole", "begun", "empty"])
def test_a_jobs_own_program_is_made_anew(tmp_path: Path, left: str) -> None:
    """Also what a killed run has left."""
    if left == "whole":
        farm.copy_program(tmp_path / farm.PROGRAM)
        (tmp_path / farm.PROGRAM / "irpso_addon" / "stale.py").write_text("x")
        (tmp_path / farm.TEMPLATE).write_text(farm.template(JOB), encoding="utf-8")
    else:
        (tmp_path / farm.PROGRAM).mkdir()
        if left == "begun":
            (tmp_path / farm.PROGRAM / "__main__.py").write_text(farm.START)
    farm._check_ours(tmp_path)
    farm.copy_program(tmp_path / farm.PROGRAM)
    farm._check_ours(tmp_path)
    farm.copy_program(tmp_path / "new")
    assert sorted(p.relative_to(tmp_path / "new") for p in (tmp_path / "new").rglob("*")) == sorted(
        p.relative_to(tmp_path / farm.PROGRAM) for p in (tmp_path / farm.PROGRAM).rglob("*"))


FREE = Costs(plan=0.0, session=0.0, dispatch=0.0, start=0.0, blocks=(2.0,), merge_start=0.0, merge=0.0,
             slowness=(1.0,))


def test_simulation_of_what_can_be_counted() -> None:
    even = simulate(FREE, Work(squares=4, across=4, tile=2), workers=8)
    assert even.seconds == 16.0 and even.efficiency == 1.0  # 16 tasks of 8 s, two a worker
    odd = simulate(FREE, Work(squares=1, across=3, tile=1), workers=2)
    assert odd.seconds == 10.0 and odd.spent["wait"] == 2.0  # nine tasks of 2 s
    few = simulate(FREE, Work(squares=1, across=2, tile=2), workers=4)
    assert few.seconds == 8.0 and few.efficiency == 0.25  # one task alone


def test_simulation_spends_all_time() -> None:
    costs = Costs(plan=50.0, session=3.0, dispatch=0.1, start=2.0, blocks=(0.5, 4.0, 6.0), merge_start=1.0, merge=0.3,
                  slowness=(1.0, 1.05, 2.0))
    work = Work(squares=5, across=5, tile=2)
    for workers in (1, 3, 40):
        found = simulate(costs, work, workers)
        assert sum(found.spent.values()) == pytest.approx(found.seconds * workers)
        assert min(found.spent.values()) >= 0
        # Graham's bound on giving tasks to whoever is free, with each task at its longest.
        longest = (0.1 + 2.0 + 4 * 6.0 * 2) + (0.1 + 1.0 + 25 * 0.3 * 2)
        tasks = found.seconds * workers - found.spent["wait"] - costs.plan * workers
        assert found.seconds <= costs.plan + tasks / workers + longest
    assert simulate(costs, work, 1).seconds > alone(costs, work)
