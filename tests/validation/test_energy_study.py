"""The study that adds up where the energy of a dam break goes, coarse and short."""

from __future__ import annotations

import csv
import json

import imageio.v3 as iio
import pytest
from tipfem.demos.validation.energy import run as study

from tipfem.app import application as commands


@pytest.mark.slow
def test_the_command_leaves_table_figure_and_figures(tmp_path, capsys):
    """Two runs, both of which close; the figures add up, and are those of the histories."""
    words = ["--spacing", "0.02", "--end-time", "0.1", "--rho-inf", "0", "0.8", "--out", str(tmp_path)]
    assert commands.demo("validation/energy", *words) == 0
    printed = capsys.readouterr().out
    assert "check: passed" in printed
    assert (tmp_path / "table.md").read_text() in printed
    assert iio.imread(tmp_path / "energy.png").std() > 5
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["check"] == "passed"
    for run, name in zip(summary["runs"], ("rho_inf_0", "rho_inf_0.8"), strict=True):
        assert run["closure"] < 5e-5
        parts = sum(run[f"{part}_dissipation"] for part in study.PARTS)
        assert run["numerical_dissipation"] == pytest.approx(parts, rel=1e-9)
        assert run["lost_energy"] == pytest.approx(run["numerical_dissipation"] + run["viscous_dissipation"], rel=5e-5)
        assert run["lost_energy"] > 0.5
        rows = list(csv.DictReader((tmp_path / name / "history.csv").open()))
        assert len(rows) == run["steps"]
        remeshing = sum(float(row["remeshing_dissipation"]) for row in rows)
        assert remeshing == pytest.approx(run["remeshing_dissipation"], rel=1e-6)
    assert summary["runs"][0]["lost_energy"] != summary["runs"][1]["lost_energy"]


def test_the_check_can_fail():
    """A budget that does not close, in energy or momentum, is named."""
    good = {
        "closure": 1e-3,
        "momentum_closure": 1e-6,
        "lost_energy": 1.0,
        "viscous_dissipation": 0.2,
        "numerical_dissipation": 0.8,
    }
    assert study.check(good) == []
    assert "closes to 2.00%" in study.check({**good, "closure": 0.02})[0]
    assert "closes to nan%" in study.check({**good, "closure": float("nan")})[0]
    assert "momentum" in study.check({**good, "momentum_closure": 1e-3})[0]
    assert "not what was dissipated" in study.check({**good, "numerical_dissipation": 0.7})[0]
    assert "not what was dissipated" in study.check({**good, "lost_energy": float("nan")})[0]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--rho-inf", "1.5"], "rho_inf is 1.5; it must be a number from 0 to 1"),
        (["--time-step", "-1"], "--time-step: '-1' is not a number > 0"),
        (["--spacing", "0"], "spacing"),
    ],
)
def test_bad_arguments_end_in_one_line(tmp_path, capsys, words, message):
    """No traceback."""
    assert commands.demo("validation/energy", *words, "--out", str(tmp_path)) > 0
    error = capsys.readouterr().err
    assert message in error
    assert len(error.splitlines()) == 1
