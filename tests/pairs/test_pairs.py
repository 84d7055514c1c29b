"""Pairs of features: each runs 20 steps with its books in order and resumes to the bit, or is refused in a sentence.

Without more being said a tenth of all pairs is drawn by the date, another one each day. ``TIPFEM_PAIRS`` is a seed for
another tenth, "all", or names: ``TIPFEM_PAIRS=hole+inlet,bingham pytest -m slow tests/pairs``.
"""

from __future__ import annotations

import datetime
import os
import random
import shutil
import warnings

import numpy as np
import pytest
from features import FEATURES, content, pairs, text

import tipfem as tp

END, HALF = 0.04, 0.02  # [s]: twenty steps of 2 ms, with a checkpoint after ten
SHARP, INTERPOLATED = 1e-9, 5e-3  # largest errors of volumes, of all fluids
RESIDUAL = 1e-8  # largest sum of the budget's residuals, of the energies of the flow
WORK = (
    *("viscous_dissipation", "numerical_dissipation", "external_work", "opening_work", "opening_energy"),
    *("beach_dissipation", "friction_dissipation"),
)


def drawn(asked: str) -> list[tuple[str, ...]]:
    """The pairs that are run, by ``TIPFEM_PAIRS``."""
    everything = pairs()
    if asked == "all":
        return everything
    if asked and not asked[0].isdigit():
        return [tuple(names.split("+")) for names in asked.split(",")]
    return random.Random(asked or datetime.date.today().isoformat()).sample(everything, len(everything) // 10)


def entered(history, name: str) -> float:
    """What has come in of a fluid through openings."""
    columns = [key for key in history[0] if key.startswith("through_") and key.endswith("_" + name)]
    return float(sum(row[key] for row in history for key in columns))


def require_books(simulation: tp.Simulation, start: dict[str, float]) -> None:
    """Volumes, energy, and a mesh that may go on."""
    history, particles = simulation.history, simulation.particles
    for name in ("position", "velocity", "acceleration", "pressure"):
        assert np.isfinite(getattr(particles, name)).all(), name
    assert simulation.mesh.measure.min() > 0
    assert (np.diff([row["time"] for row in history]) > 0).all()
    allowed = SHARP if simulation.case.interface == "sharp" else INTERPOLATED
    for name, before in start.items():
        error = (simulation.volume(name) - before - entered(history, name)) / sum(start.values())
        assert abs(error) < allowed, f"volume of {name}: {error:+.1e}"
    column = {name: np.array([row.get(name, 0.0) for row in history]) for name in (*WORK, "kinetic_energy")}
    ranged = np.ptp([row["potential_energy"] for row in history])
    scale = max(column["kinetic_energy"].max(), ranged, sum(np.abs(column[name]).sum() for name in WORK))
    residual = np.abs([row["energy_residual"] for row in history]).sum()
    assert residual <= RESIDUAL * scale, f"energy: {residual / scale:.1e}"


def require_same(one: tp.Simulation, other: tp.Simulation) -> None:
    """The same to the bit, but for the time that it took."""
    for name in ("position", "velocity", "acceleration", "pressure", "fluid"):
        np.testing.assert_array_equal(getattr(one.particles, name), getattr(other.particles, name), name)
    assert len(one.history) == len(other.history)
    last = [{key: value for key, value in run.history[-1].items() if key != "wall_seconds"} for run in (one, other)]
    np.testing.assert_equal(*last)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("names", drawn(os.environ.get("TIPFEM_PAIRS", "")), ids="+".join)
def test_a_pair_of_features_runs_and_resumes_or_is_refused(names, tmp_path):
    path = tmp_path / "case.toml"
    path.write_text(text(content(names)))
    out, middle = tmp_path / "out", tmp_path / "middle"
    try:
        simulation = tp.load_case(path).simulation(out=out)
    except ValueError as error:
        said = str(error)
        assert len(said) > 30, said
        assert "Traceback" not in said
        pytest.skip(f"refused: {said.splitlines()[-1][:150]}")
    start = {fluid.name: simulation.volume(fluid.name) for fluid in simulation.case.fluids}
    simulation.run(HALF, progress=False)
    shutil.copytree(out, middle)
    simulation.run(END, progress=False)
    require_books(simulation, start)
    resumed = tp.Simulation.resume(middle)
    resumed.run(END, progress=False)
    require_same(simulation, resumed)


def test_a_tenth_is_another_one_every_day_and_the_same_all_day():
    assert drawn("2026-01-01") == drawn("2026-01-01") != drawn("2026-01-02")
    assert len(drawn("2026-01-01")) == len(pairs()) // 10
    assert drawn("hole+inlet,arc") == [("hole", "inlet"), ("arc",)]
    assert set().union(*drawn("all")) == set(FEATURES)


@pytest.mark.parametrize("name", list(FEATURES))
def test_a_feature_alone_is_a_case(name, tmp_path):
    """One that is refused alone would test nothing in pairs."""
    path = tmp_path / "case.toml"
    path.write_text(text(content((name,))))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        tp.load_case(path).case()
