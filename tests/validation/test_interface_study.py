"""The study of the two interface rules, as its user runs it, coarse and short."""

from __future__ import annotations

import csv
import json

import imageio.v3 as iio
import pytest
from tipfem.demos.validation.interfaces import run as study

from tipfem.app import application as commands


@pytest.mark.slow
def test_the_short_version_leaves_what_it_promises(tmp_path, capsys):
    """Pictures, table and figures of both rules; the sharp one rests, and the other does not."""
    assert commands.demo("validation/interfaces", "--short", "--out", str(tmp_path)) == 0
    printed = capsys.readouterr().out
    assert "check: passed" in printed
    assert (tmp_path / "table.md").read_text() in printed
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["check"] == "passed"
    for name in ("rest", "dam_break", "budget", "front", "sloshing"):
        assert iio.imread(tmp_path / f"{name}.png").std() > 5
    sharp, other = summary["figures"]["sharp"], summary["figures"]["interpolated"]
    assert set(sharp) == set(other)
    rests = [name for name in sharp if name.startswith("rest_")]
    assert len(rests) == 4
    assert max(sharp[name] for name in rests) < 1e-10
    assert min(other[name] for name in rests) > 1e-5
    for rule, figures in summary["figures"].items():
        rows = list(csv.DictReader((tmp_path / "dam_break" / rule / "history.csv").open()))
        assert len(rows) == figures["dam_steps"]
        assert sum(float(row["newton_iterations"]) for row in rows) / len(rows) == figures["dam_newton_a_step"]
        assert 0 < figures["dam_remeshing_share"] < 1


def test_the_check_can_fail():
    """What the sharp rule misses is named; what was not run is not judged."""
    good = {
        "rest_a": 1e-12,
        "dam_volume_error": 1e-12,
        "sloshing_decay": 1e-8,
        "sloshing_end": 10.0,
        "dam_front_rms": 0.03,
        "dam_remeshing_absolute": 1.0,
        "dam_remeshing_momentum_absolute": 1.0,
    }
    other = {"dam_remeshing_absolute": 2.0, "dam_remeshing_momentum_absolute": 2.0}

    def missed(short=False, **changed):
        return study.check({"sharp": {**good, **changed}, "interpolated": other}, 0.01, short)

    assert missed() == []
    assert study.check({"sharp": {}, "interpolated": {}}, 0.01) == []
    assert missed(rest_a=1e-3) == ["rest_a is 0.001, above 1e-09"]
    assert missed(rest_a=float("nan")) == ["rest_a is nan, above 1e-09"]
    assert "dam_volume_error" in missed(dam_volume_error=1e-3)[0]
    assert missed(sloshing_decay=0.01) == ["sloshing_decay is 0.01, above 1e-06"]
    assert missed(sloshing_decay=0.01, sloshing_end=5.0) == []
    assert missed(True, dam_front_rms=0.06) == []
    assert missed(dam_front_rms=0.06) == ["front_rms is 0.06, above 0.05"]
    assert missed(dam_remeshing_momentum_absolute=3.0) == [
        "dam_remeshing_momentum_absolute is 3, not below the interpolated rule's 2"
    ]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--only", "dam", "--spacing", "-1"], "--spacing: '-1' is not a number > 0"),
        (["--only", "sloshing", "--sloshing-end", "nan"], "--sloshing-end: 'nan' is not a number > 0"),
        (["--only", "dam", "--spacing", "0.5"], "spacing is 0.5 m, too large"),
    ],
)
def test_bad_arguments_end_in_one_line(tmp_path, capsys, words, message):
    """No traceback."""
    assert commands.demo("validation/interfaces", *words, "--short", "--out", str(tmp_path)) > 0
    error = capsys.readouterr().err
    assert message in error
    assert len(error.splitlines()) == 1
