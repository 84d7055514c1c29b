"""demos/validation/dam_break/run.py: runs at several spacings, and finished runs in one figure."""

from __future__ import annotations

import json

import imageio.v3 as iio
import numpy as np
import pytest
from tipfem.demos.validation.dam_break import run as study

from tipfem.app import application as commands


def finished_run(folder, spacing, speed):
    """What a run whose front moves at a constant speed [m/s] would have left."""
    folder.mkdir()
    (folder / "summary.json").write_text(json.dumps({"spacing": spacing}))
    rows = [f"{t},{0.146 + speed * t},0.28,0.0426" for t in np.arange(1, 61) * 0.005]
    (folder / "history.csv").write_text("\n".join(["time,front,column_height,volume_water", *rows]) + "\n")
    return folder


def test_fronts_of_several_runs_in_one_figure(tmp_path, capsys):
    """--compare runs nothing: it reads histories, prints the figures of each and draws them together."""
    folders = [finished_run(tmp_path / name, h, v) for name, h, v in (("fine", 0.002, 1.5), ("coarse", 0.005, 1.4))]
    assert commands.demo("validation/dam_break", "--compare", *map(str, folders), "--out", str(tmp_path / "both")) == 0
    printed = capsys.readouterr().out
    assert printed.index("tipfem, 5 mm: ") < printed.index("tipfem, 2 mm: ")
    assert "front_rms" in printed
    assert iio.imread(tmp_path / "both" / "fronts.png").std() > 5
    assert [path.name for path in (tmp_path / "both").iterdir()] == ["fronts.png"]


def test_what_is_no_run_cannot_be_compared(tmp_path, capsys):
    """One line names the folder."""
    for name, text in (("nothing", None), ("other", "time\n0.1\n")):
        folder = tmp_path / name
        if text:
            finished_run(folder, 0.005, 1.0)
            (folder / "history.csv").write_text(text)
        assert commands.demo("validation/dam_break", "--compare", str(folder)) == 2
        assert f"{folder}: no finished run of the dam break" in capsys.readouterr().err


@pytest.mark.slow
def test_coarse_runs_are_compared_and_checked(tmp_path, capsys, monkeypatch):
    """Two runs, their fronts in one figure; too short for the front, which is known to a spacing, to be judged."""
    monkeypatch.setattr(study, "END_TIME", 0.12)  # T = 1.4
    assert commands.demo("validation/dam_break", "--spacing", "0.03", "0.02", "--out", str(tmp_path)) == 0
    assert "check: passed" in capsys.readouterr().out
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["check"] == "passed"
    assert list(summary["figures"]) == ["tipfem, 30 mm", "tipfem, 20 mm"]
    for figures in summary["figures"].values():
        assert figures["volume_error"] < 1e-8
    for name in ("fronts.png", "20mm/history.csv", "30mm/summary.json"):
        assert (tmp_path / name).stat().st_size > 0
