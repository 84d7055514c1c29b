"""The wall study, as its user runs it, coarse; and one run of the driven cavity as fine as it is by default."""

from __future__ import annotations

import imageio.v3 as iio
import numpy as np
import pytest
from demo_runs import called
from tipfem.demos.validation.walls import floor
from tipfem.demos.validation.walls import run as study


def run(out, *words):
    """The summary of the study, by the function behind `tipfem demo`; it must pass its check."""
    return called("validation/walls", out, *words)


@pytest.mark.slow
def test_the_short_version_leaves_what_it_promises(tmp_path):
    summary = run(tmp_path / "results", "--short", "--only", "moving", "dam", "driven")
    assert summary["check"] == "passed"
    assert summary["figures"]["roll_velocity"] < 0.5 * summary["figures"]["roll_velocity_9"]
    for name in ("rolled", "pistons", "dam_break", "driven_cavity"):
        assert iio.imread(tmp_path / "results" / f"{name}.png").std() > 5


def test_check_finds_what_is_wrong():
    good = {"vortex_decay": 0.001, "vortex_order": 1.9, "driven_100": 0.01, "sway_pressure": 1e-4}
    assert study.check(good) == []
    assert study.check({**good, "driven_100": 0.04}) == ["driven_100 is 0.04, above 0.03"]
    assert study.check({**good, "sway_pressure": float("nan")}) == ["sway_pressure is nan, above 0.002"]
    assert study.check({**good, "vortex_order": 1.2}) == ["vortex_order is 1.20, below 1.7"]


def test_reference_data_of_the_driven_cavity():
    """Both tables end on the walls, and the point that the paper misprints is left out."""
    for reynolds, count in ((100, 17), (400, 16)):
        y, u, x, v = study.ghia(reynolds)
        assert (len(y), len(x)) == (17, count)
        assert dict(zip(y, u, strict=True))[1.0] == 1.0
        ends = dict(zip(x, v, strict=True))
        assert ends[0.0] == ends[1.0] == 0.0
        assert np.abs(v).max() < 0.5


@pytest.mark.slow
def test_the_layer_of_the_floor_is_that_of_a_stagnating_flow():
    """U = k x: the steady traction is 1.2326 rho sqrt(nu k) U (Hiemenz; Schlichting & Gersten, section 5.1)."""
    k, length, nu = 10.0, 0.584, 1e-6
    x = np.linspace(0.005, length - 0.005, 60)
    course = [floor.Outer(t, x, k * x, length) for t in np.linspace(0.0, 0.4, 5)]
    taken, before = (floor.friction(part, length, 1e3 * nu, 1e3) for part in (course, course[:-1]))
    traction = 1.2326 * 1e3 * np.sqrt(nu * k) * k
    assert taken[0] - before[0] == pytest.approx(0.1 * traction * length**2 / 2, rel=0.03)
    assert taken[1] - before[1] == pytest.approx(0.1 * traction * k * length**3 / 3, rel=0.03)


@pytest.mark.slow
def test_friction_on_the_floor_of_a_dam_break(tmp_path):
    figures = run(tmp_path, "--short", "--only", "floor")["figures"]
    assert 0.5 < 1 - figures["floor_impulse"] < 1


@pytest.mark.slow
def test_driven_cavity_against_ghia(tmp_path):
    """Re = 100 and 400 within 3 % of the lid's speed."""
    figures = run(tmp_path, "--only", "driven")["figures"]
    assert figures["driven_100"] < 0.03
    assert figures["driven_400"] < 0.03


@pytest.mark.slow
def test_everything_else_as_fine_as_by_default(tmp_path):
    run(tmp_path, "--only", "vortex", "long", "dam", "floor", "moving")
