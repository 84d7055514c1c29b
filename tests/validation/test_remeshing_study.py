"""The study of remeshing alone: its flows, coarse and short, and what its check finds."""

import json

import numpy as np
import pytest
from tipfem.demos.validation.remeshing import flows, run

from tipfem.app import application as commands
from tipfem.mesh.mesh import Mesh


@pytest.mark.parametrize("name", flows.FLOWS)
def test_flows_are_free_of_divergence_and_at_rest_at_the_walls(name):
    flow, step = flows.FLOWS[name], 1e-6
    rng = np.random.default_rng(0)
    x = rng.uniform(0.01, 0.99, (200, flow.dimension))
    total = np.zeros(len(x))
    for k, axis in enumerate(step * np.eye(flow.dimension)):
        total += (flow.velocity(x + axis, 0.1) - flow.velocity(x - axis, 0.1))[:, k] / (2 * step)
    np.testing.assert_allclose(total, 0.0, atol=1e-6)
    for k in range(flow.dimension):
        x[:, k] = rng.integers(0, 2, len(x))
        np.testing.assert_allclose(flow.velocity(x, 0.1), 0.0, atol=1e-12)
        x[:, k] = rng.uniform(0.01, 0.99, len(x))


def test_angles_are_those_of_known_cells():
    triangle = Mesh(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), np.array([[0, 1, 2]], dtype=np.int32))
    assert run.smallest_angle(triangle) == pytest.approx(45.0)
    corners = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    regular = Mesh(corners, np.array([[0, 1, 2, 3]], dtype=np.int32))
    assert run.smallest_angle(regular) == pytest.approx(np.degrees(np.arccos(1 / 3)))


@pytest.mark.parametrize(
    ("name", "across", "end"), [("vortex", 25, 1.0), ("deformation", 13, 0.3), ("halves", 12, 0.1)]
)
def test_a_body_on_its_way(name, across, end):
    """Volumes stay, no cell is a sliver, no step is refused, nothing is torn."""
    found = run.carry(flows.FLOWS[name], across, end)
    assert found["refused"] == 0
    assert found["angle"] > 3.0
    assert found["filled"] < 1e-12
    assert found["volume"] < 1e-12
    assert found["pieces"] == (2 if name == "halves" else 1)
    assert run.check(name, found) == []


@pytest.mark.slow
def test_two_drops_become_one_and_a_thread_breaks():
    assert run.carry(flows.FLOWS["meeting"], 14)["pieces"] == 1
    assert run.carry(flows.FLOWS["thread"], 12)["pieces"] > 1


def test_the_check_can_fail():
    found = {"refused": 1, "angle": 1.0, "volume": 1e-3, "filled": 1e-3, "pieces": 3, "shape": 2.0}
    assert len(run.check("deformation", found)) == 6


@pytest.mark.slow
def test_the_study_leaves_what_it_promises(tmp_path, capsys):
    """A disc in a vortex and back, with 10 000 particles: angle above 7 degrees, error of the shape below 7e-4."""
    assert commands.demo("validation/remeshing", "--flow", "vortex", "--out", str(tmp_path)) == 0
    assert "check: passed" in capsys.readouterr().out
    found = json.loads((tmp_path / "summary.json").read_text())["runs"]["vortex"]
    assert found["shape"] / 100 < 7e-4
    assert (tmp_path / "angles.png").exists()
