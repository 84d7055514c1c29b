"""Studies with a mistake, and the list of a dry run: nothing is started, nothing is written."""

from __future__ import annotations

import subprocess
import sys
from concurrent.futures import Future
from pathlib import Path

import pytest

from tipfem.app.application import app
from tipfem.app.commands import call
from tipfem.app.study.running import LocalWorkers, Outcome, folder_of, prepare, usable_cores
from tipfem.app.study.study import load_study
from tipfem.casefile.problems import CaseFileError

BASE = Path(__file__).with_name("column.toml").read_text("utf-8")
GRID = 'case = "base.toml"\n[grid]\nfluids.water.viscosity = [1e-3, 1e-2]\n'


@pytest.fixture
def write(tmp_path, monkeypatch):
    """Writes study.toml beside base.toml, in the present folder."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "base.toml").write_text(BASE, encoding="utf-8")

    def write(text: str) -> Path:
        path = tmp_path / "study.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


def test_the_plan_has_the_grid_first_then_the_runs(write):
    study = load_study(
        write(
            'case = "base.toml"\nfolder = "here"\n[set]\ntime.end = 0.02\n'
            "[grid]\nfluids.water.viscosity = [1e-3, 1e-2]\ntank.spacing = [0.08, 0.1]\n"
            '[[runs]]\nname = "thick"\nfluids.water.viscosity = 0.1\n[[runs]]\nfluids.air.viscosity = 1e-4\n'
        )
    )
    assert study.folder == Path("here")
    assert [run.name for run in study.runs] == [
        "fluids.water.viscosity=0.001,spacing=0.08",
        "fluids.water.viscosity=0.001,spacing=0.1",
        "fluids.water.viscosity=0.01,spacing=0.08",
        "fluids.water.viscosity=0.01,spacing=0.1",
        "thick",
        "fluids.air.viscosity=0.0001",
    ]
    assert all(run.file.end == 0.02 for run in study.runs)
    assert study.runs[2].values == {"fluids.water.viscosity": 0.01, "tank.spacing": 0.08}
    assert [run.file.table.fluids["water"].viscosity for run in study.runs] == [1e-3, 1e-3, 1e-2, 1e-2, 0.1, 1e-3]


def test_runs_are_named_so_that_the_value_is_known(write):
    text = 'case = "base.toml"\n[[runs]]\nsurface_tension.water.air = 0.03\n[[runs]]\nfluids.water = { density = 1 }\n'
    study = load_study(write(text.replace("fluids.water = { density = 1 }", "time.end = 0.03")))
    assert [run.name for run in study.runs] == ["surface_tension.water.air=0.03", "end=0.03"]


def test_a_dry_run_lists_the_runs_and_writes_nothing(write, tmp_path, capsys):
    path = write(GRID)
    assert app(["sweep", str(path), "--dry-run"], result_action="return_value") == 0
    lines = capsys.readouterr().out.splitlines()
    lines = lines[-3:]
    assert lines[0].startswith("viscosity=0.001: fluids.water.viscosity = 0.001; ")
    assert lines[1].startswith("viscosity=0.01: fluids.water.viscosity = 0.01; ")
    assert all("particles, about " in line and line.endswith("; not started") for line in lines[:2])
    assert lines[2].startswith("2 runs, about ")
    assert not (tmp_path / "out").exists()


BAD = {
    "unknown key": ("caze = 3\n" + GRID, "caze", "is not a known key"),
    "unknown key of the case": (GRID.replace("viscosity", "viscosty"), "fluids.water.viscosty", "viscosity"),
    "bad value": (GRID.replace("1e-2", "-1"), "fluids.water.viscosity", "-1"),
    "empty grid": ('case = "base.toml"\n[grid]\n', "study.toml", "neither a grid nor runs"),
    "empty list": (GRID.replace("[1e-3, 1e-2]", "[]"), "fluids.water.viscosity is []", "not empty"),
    "no base": (GRID.replace('case = "base.toml"\n', ""), "study.toml", "case is missing"),
    "base that is not there": (GRID.replace("base", "bass"), "'bass.toml'", "there is no such file"),
    "duplicate names": (GRID + '[[runs]]\nname = "a"\n[[runs]]\nname = "a"\n', "two runs 'a'", "of its own"),
    "duplicate values": (GRID.replace("1e-2", "1e-3"), "two runs 'viscosity=0.001'", "of its own"),
    "name of no folder": (GRID + '[[runs]]\nname = "../a"\n', "'../a'", "names a folder"),
    "name of the table": (GRID + '[[runs]]\nname = "study.csv"\n', "'study.csv'", "table"),
    "grid without lists": (GRID.replace("[1e-3, 1e-2]", "1e-3"), "fluids.water.viscosity is 0.001", "a list of values"),
    "grid that is no table": ('grid = 3\ncase = "base.toml"\n[[runs]]\nname = "a"\n', "grid is 3", "table"),
    "runs that are no tables": ("runs = [1]\n" + GRID, "runs", "1"),
    "case that is no text": (GRID.replace('"base.toml"', "3"), "case", "3"),
    "folder that is no text": ("folder = 3\n" + GRID, "folder", "3"),
    "empty folder": ('folder = ""\n' + GRID, "folder", "''"),
    "setting out of range": (GRID + "[set]\ntime.end = -1\n", "time.end", "-1"),
    "setting of the wrong type": (GRID + '[set]\ntime.end = "long"\n', "time.end", "long"),
    "value that is no number": (GRID.replace("1e-2", "nan"), "fluids.water.viscosity", "nan"),
    "table as a value": (GRID.replace("1e-2", "{a = 1}"), "fluids.water.viscosity", "a"),
    "no TOML": ("case = \n", "study.toml:1", "not valid TOML"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_mistake_is_one_clear_message(name, write, tmp_path, capsys):
    text, *parts = BAD[name]
    assert app(["sweep", str(write(text))], result_action="return_value") == 2
    said = capsys.readouterr().err
    assert all(part in said for part in parts), said
    assert "1 mistake; nothing was started" in said
    assert "Traceback" not in said
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_broken_study_is_refused_without_taichi(write, tmp_path):
    write(BAD["bad value"][0])
    code = (
        "import sys; from tipfem.app.application import app; "
        "code = app(['sweep', 'study.toml'], result_action='return_value')"
        "; sys.exit(99 if 'taichi' in sys.modules else code)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    assert "study.toml" in done.stderr


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--workers", "0"], "--workers is 0"),
        (["--threads", "0"], "--threads is 0"),
        (["--workers", "100000"], "need 100000 cores"),
        (["--threads", "100000"], "need 100000 cores"),
        (["--workers", "-1"], "--workers is -1"),
    ],
)
def test_bad_options_are_refused(words, message, write, tmp_path, capsys):
    assert app(["sweep", str(write(GRID)), *words], result_action="return_value") == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nothing.toml"], "nothing.toml"),
        (["."], "."),
        (["study.toml", "--workers", "two"], "two"),
        (["study.toml", "--threads", "1.5"], "1.5"),
        (["study.toml", "--speed", "9"], "--speed"),
        ([], "STUDY"),
    ],
)
def test_bad_command_lines_end_with_2(words, message, write, tmp_path, capsys):
    write(GRID)
    assert call(app, ["sweep", *words]) == 2
    said = capsys.readouterr()
    assert message in said.out + said.err
    assert "Traceback" not in said.out + said.err
    assert not (tmp_path / "out").exists()


def test_all_mistakes_are_told_at_once(write):
    with pytest.raises(CaseFileError) as caught:
        load_study(write(GRID.replace("base", "bass") + '[[runs]]\nname = ""\n'))
    assert len(caught.value.problems) == 2


def test_a_run_of_another_case_is_kept_unless_overwritten(write, capsys):
    study = load_study(write(GRID))
    prepare(study, overwrite=False)
    begun = folder_of(study, study.runs[0])
    (begun / "history.csv").write_text("time\n")
    (begun / "summary.json").write_text("{}")
    path = write(GRID + "[set]\ngravity = [0, -1]\n")
    assert app(["sweep", str(path)], result_action="return_value") == 2
    assert "holds a run of another case" in capsys.readouterr().err
    assert (begun / "summary.json").exists()
    prepare(load_study(path), overwrite=True)
    assert not (begun / "summary.json").exists()


def test_a_run_that_is_killed_every_time_is_given_up(write, monkeypatch, capsys):
    def killed(self: LocalWorkers, folder: Path) -> Future[Outcome]:
        started.append(folder.name)
        task: Future[Outcome] = Future()
        task.set_result(Outcome(-9, "killed by signal 9"))
        return task

    started: list[str] = []
    monkeypatch.setattr(LocalWorkers, "submit", killed)
    assert len(usable_cores()) >= 1
    assert (
        app(
            ["sweep", str(write('case = "base.toml"\n[[runs]]\nname = "a"\n')), "--workers", "1"],
            result_action="return_value",
        )
        == 1
    )
    assert started == ["a"] * 4
    assert "a: killed by signal 9  (0 of 1 complete)" in capsys.readouterr().out
