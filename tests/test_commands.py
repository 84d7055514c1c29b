"""The command `tipfem`: its help, the list of demos, and running one."""

from __future__ import annotations

import csv
import json
import runpy
import sys

import pytest
from demo_runs import DEMOS, called, python

from tipfem.app import application as commands
from tipfem.app.main import main

SCRIPTS = sorted(path.stem for path in DEMOS.glob("*.py") if path.stem not in ("__init__", "harness"))


def test_the_list_has_every_demo_with_a_line(capsys):
    """Under their headings; helpers are not listed."""
    commands.demo()
    lines = capsys.readouterr().out.splitlines()
    first, second, third = (lines.index(f"{heading}:") for heading in commands.SECTIONS.values())
    assert [line.split()[0] for line in lines[first + 1 : second - 1]] == SCRIPTS
    assert len(SCRIPTS) >= 7
    studies = [line.split()[0] for line in lines[second + 1 : third - 1]]
    assert studies == [
        f"validation/{name}"
        for name in (
            "bodies",
            "contact",
            "dam_break",
            "drop",
            "drops",
            "energy",
            "impact",
            "interfaces",
            "openings",
            "periodic",
            "remeshing",
            "rheology",
            "round",
            "shapes",
            "three_d",
            "walls",
            "waves",
        )
    ]
    assert lines[third + 1].split()[0] == "benchmarks/frame_time"
    listed = [line for line in lines if line.startswith("  ")]
    assert all(len(line.split()) > 4 for line in listed)
    assert max(map(len, lines)) <= 130


@pytest.mark.slow
def test_help_needs_no_taichi():
    """Neither the help nor the list imports it: they are there at once."""
    code = (
        "import sys; from tipfem.app import application as commands; commands.demo(); sys.exit('taichi' in sys.modules)"
    )
    done = python("-c", code)
    assert done.returncode == 0, done.stderr
    assert "dam_break" in done.stdout
    shown = python("-m", "tipfem", "--help")
    assert shown.returncode == 0
    assert "demo" in shown.stdout
    assert "Run a demo" in python("-m", "tipfem", "demo", "--help").stdout


def test_what_reads_cases_and_results_needs_no_taichi():
    """It takes half a second to load, and prints a line of its own where the kernels' part has not silenced it."""
    modules = (
        "tipfem.casefile.schema, tipfem.casefile.loading, tipfem.results.reader, tipfem.probes, tipfem.mesh.delaunay"
    )
    done = python("-c", f"import sys, {modules}; sys.exit('taichi' in sys.modules)")
    assert done.returncode == 0, done.stderr
    assert not done.stdout


def test_a_command_ends_at_once():
    """Objects that hold one another are left to the system, as many as imports have made, and not unlinked."""
    code = (
        "class Told:\n    def __del__(self): print('unlinked')\n"
        "import gc, sys; told = Told(); told.itself = told; del told; gc.disable()\n"
        "if sys.argv[1:]: import tipfem.app\n"
    )
    assert python("-c", code).stdout == "unlinked\n"
    assert python("-c", code, "app").stdout == ""


@pytest.mark.slow
def test_the_command_a_user_types(tmp_path):
    """What README says a fresh installation can do."""
    words = ["--spacing", "0.02", "--end-time", "0.1", "--no-frames", "--out", tmp_path]
    done = python("-m", "tipfem", "demo", "dam_break", *words)
    assert done.returncode == 0, done.stderr
    assert "check: passed" in done.stdout
    assert json.loads((tmp_path / "summary.json").read_text())["spacing"] == 0.02


def test_each_demo_shows_its_options(capsys):
    """A demo's own --help, and not that of `tipfem demo`."""
    assert commands.demo("layers_at_rest", "--help") == 0
    shown = capsys.readouterr().out
    assert shown.startswith("Usage: tipfem demo layers_at_rest ")
    assert "--layers" in shown
    assert "[default: sharp]" in shown
    assert "default: None" not in shown
    assert "default: False" not in shown


@pytest.mark.parametrize("name", [name for part in commands.find_demos().values() for name in part])
def test_every_demo_has_help(name, capsys):
    assert commands.demo(name, "--help") == 0
    assert capsys.readouterr().out.startswith(f"Usage: tipfem demo {name} ")


@pytest.mark.parametrize("name", ["layers_at_rest", "dam_break_free_surface"])  # of a function, and of a case file
def test_a_demo_takes_the_options_of_run(name, tmp_path, capsys):
    words = ["--spacing", "0.02", "--set", "numerics.volume_correction=2.5", "--set", "time.largest_step=0.002"]
    summary = called(name, tmp_path, *words, "--until", "0.004", "--no-frames", "--no-progress")
    assert summary["time"] == 0.004
    assert summary["spacing"] == 0.02
    assert summary["numerics"]["volume_correction"] == 2.5
    assert summary["largest_time_step"] == 0.002
    assert "volume_correction = 2.5" in (tmp_path / "case.toml").read_text()
    capsys.readouterr()
    assert commands.demo(name, "--set", "numerics.volume_corection=1.0", "--out", str(tmp_path / "none")) == 2
    assert "numerics.volume_corection" in capsys.readouterr().err
    assert not (tmp_path / "none").exists()


def test_a_demo_that_is_not_there(capsys):
    assert commands.demo("dam_brake") == 2
    assert "there is no demo 'dam_brake'; did you mean 'dam_break'" in capsys.readouterr().err
    assert commands.demo("volcano") == 2
    assert "there is no demo 'volcano'; `tipfem demo` lists all of them" in capsys.readouterr().err


@pytest.mark.parametrize("words", [(), ("list",), ("--list",)])
def test_the_demos_are_listed(words, capsys):
    commands.demo(*words)
    shown = capsys.readouterr().out
    assert shown.startswith("Demos:\n  ")
    assert "\n  dam_break " in shown


def test_the_console_script_is_the_same_command():
    scripts = (DEMOS.parent / "pyproject.toml").read_text().partition("[project.scripts]")[2]
    assert scripts.split("\n")[1] == 'tipfem = "tipfem.app.main:main"'
    assert callable(main)


@pytest.mark.slow
def test_a_source_tree_that_is_not_installed_in_place_has_pictures_and_demos():
    """As from a clone of a tipfem that is installed elsewhere, where Python imports the clone's folder."""
    code = (
        "import sys; sys.meta_path = [one for one in sys.meta_path if 'editable' not in repr(one).lower()]; "
        f"sys.path.insert(0, {str(DEMOS.parent)!r}); import tipfem.render, tipfem.demos.support; "
        "print(tipfem.render.__file__); from tipfem.app.application import demo; demo()"
    )
    done = python("-c", code)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[0] == str(DEMOS.parent / "render" / "__init__.py")
    assert "dam_break" in done.stdout


def test_a_copy_of_a_demo_runs_anywhere(tmp_path, monkeypatch, capsys):
    """Copied out of the repository and changed, a demo still runs."""
    copy = tmp_path / "mine.py"
    copy.write_text((DEMOS / "obstacle.py").read_text().replace("(0.1461, 0.292)", "(0.2, 0.2)"))
    words = ["--spacing", "0.04", "--end-time", "0.02", "--no-frames", "--out", str(tmp_path / "out")]
    monkeypatch.setattr(sys, "argv", [str(copy), *words])
    with pytest.raises(SystemExit):  # with the code of its check
        runpy.run_path(str(copy), run_name="__main__")
    assert "check: " in capsys.readouterr().out
    with (tmp_path / "out" / "history.csv").open() as file:
        assert float(next(csv.DictReader(file))["volume_water"]) == pytest.approx(0.04, rel=1e-3)


@pytest.mark.slow
def test_a_refused_case_names_the_line_of_the_script(tmp_path):
    """One line; an error of the script's own keeps its traceback."""
    script = """import tipfem as tp
from tipfem.demos import harness
def case(spacing: float = 1.0):
    return WRONG
main = harness.Demo(case, end_time=1, time_step=1, frames_per_second=1)
harness.command(__name__)
"""
    bad = tmp_path / "bad.py"
    bad.write_text(script.replace("WRONG", "tp.Fluid('water', density=-1.0, viscosity=1.0)"))
    done = python(bad)
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert done.stderr.startswith("error: ")
    assert "(bad.py, line 4)" in done.stderr
    bad.write_text(script.replace("WRONG", "float('nothing')"))
    assert "Traceback" in python(bad).stderr
