"""demos/benchmarks/performance.py: what it measures with, on small sizes."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest
from tipfem.demos.benchmarks import cases, peers, performance, states

from tipfem.mesh.mesh import Mesh, simplex_measure


@pytest.fixture(scope="module")
def state(tmp_path_factory):
    path = tmp_path_factory.mktemp("state") / "state.npz"
    states.make_state(path, 0.04)
    return dict(np.load(path))


def test_a_refined_state_is_the_same_flow_on_four_times_the_triangles(state):
    finer = states.refined(state)
    assert len(finer["cells"]) == 4 * len(state["cells"])
    assert float(finer["spacing"]) == float(state["spacing"]) / 2
    measure = simplex_measure(finer["position"], finer["cells"])
    assert (measure > 0).all()
    for fluid in (0, 1):
        old = simplex_measure(state["position"], state["cells"])[state["fluid"] == fluid].sum()
        assert measure[finer["fluid"] == fluid].sum() == pytest.approx(old, rel=1e-12)
    mesh = Mesh(finer["position"], finer["cells"])
    cell, i = np.nonzero(mesh.neighbours < 0)
    hull = np.unique([mesh.cells[cell, (i + 1) % 3], mesh.cells[cell, (i + 2) % 3]])
    np.testing.assert_array_equal(np.flatnonzero(finer["wall"]), hull)
    number = {tuple(x): i for i, x in enumerate(finer["position"].tolist())}
    kept = [number[tuple(x)] for x in state["position"].tolist()]
    np.testing.assert_array_equal(finer["velocity"][kept], state["velocity"])
    assert (np.diff(finer["cells"].min(axis=1)) >= 0).all()
    assert abs(finer["velocity"]).max() <= abs(state["velocity"]).max()


def test_a_refined_state_runs_and_is_measured(state):
    figures = cases.measure_steps(states.refined(state), steps=2)
    assert figures["particles"] == len(states.refined(state)["position"])
    assert set(figures["parts"]) == {*cases.TIMERS, *cases.SHARED, "remeshing"}
    assert 0 < sum(figures["parts"].values()) < figures["step"]
    assert 1e8 < figures["copy"] < 1e12
    json.dumps(figures)


def test_direct_solvers_and_ours_solve_the_same_system(state, tmp_path):
    found = cases.measure_solvers(state, direct=True)
    assert found["iterations"] < 20
    assert found["superlu"] > 0
    rows = [{"threads": 2, "arch": "cpu", **cases.measure_steps(state, 1), "solvers": found}]
    text = performance.table(rows)
    assert f"| {found['particles']} | 2 thread(s) |" in text
    assert performance.check(rows, {"hard": (100, 20)}) == []
    rows[0]["solvers"] = found | {"iterations": 99}
    assert "99 iterations" in performance.check(rows, {"hard": (100, 90)})[0]
    assert len(performance.check(rows, {"hard": (100, 90)})) == 2
    peers.keep(tmp_path / "figures.csv", performance.kept(rows), "a command", "1234567")
    with (tmp_path / "figures.csv").open(encoding="utf-8", newline="") as file:
        figures = {row["figure"]: (float(row["value"]), row["unit"]) for row in csv.DictReader(file)}
    assert figures["step"] == (pytest.approx(1e3 * rows[0]["step"], rel=1e-3), "ms")
    assert set(figures) == {"step", "first_step", "newton", "krylov", "memory"}
