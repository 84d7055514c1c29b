"""Cells that what moves towards each other would flatten in a step: of fluids, and of empty space between surfaces."""

import numpy as np
import pytest

from tipfem.errors import TriangulationError
from tipfem.mesh.mesh import Mesh, simplex_measure
from tipfem.remesh.cavity.arrays import RELABEL
from tipfem.remesh.cavity.cavities import Cavities, Task
from tipfem.remesh.cavity.empty_cells import Slipping, followed
from tipfem.remesh.cavity.sheets import FLAT, STOPPED, stop_flattening

HEIGHT, DT = np.sqrt(2 / 3), 0.01
DENSITY = np.array([0.0, 1000.0])


def pile(label, speed) -> Cavities:
    """Regular tetrahedra with sides of 1 m on the faces of one, of these labels, the first its own; its top moves."""
    x = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, np.sqrt(0.75), 0], [0.5, np.sqrt(1 / 12), HEIGHT]])
    x = np.concatenate([x, 2 / 3 * (x.sum(axis=0) - x) - x])
    cells = np.array([[0, 1, 2, 3], [1, 3, 2, 4], [0, 2, 3, 5], [0, 3, 1, 6], [0, 1, 2, 7]], dtype=np.int32)
    cells[simplex_measure(x, cells) < 0, :2] = cells[simplex_measure(x, cells) < 0, 1::-1]
    mesh = Mesh(x, cells, np.array(label, dtype=np.int32))
    fields = np.zeros((8, 7))
    fields[3, :3] = speed
    return Cavities(mesh, np.zeros(8, dtype=bool), 1.0, fields)


def left(found: Cavities) -> np.ndarray:
    """The part of its volume that each cell would keep in a step."""
    mesh = found.mesh()
    return simplex_measure(mesh.position + DT * found.fields[: len(mesh.position), :3], mesh.cells) / mesh.measure


def of_particles(found: Cavities) -> tuple[np.ndarray, float]:
    """Momentum and energy."""
    mesh = found.mesh()
    corner = found.fields[mesh.cells, :3]
    mass = (DENSITY[mesh.fluid] * mesh.measure / 4)[:, None]
    return (mass[..., None] * corner).sum(axis=(0, 1)), 0.5 * float((mass * (corner**2).sum(axis=2)).sum())


@pytest.mark.parametrize("part", [0.7, 1.5])
def test_what_would_flatten_a_cell_is_stopped(part):
    """Momentum stays, energy is taken, pressures and accelerations are as they were, and no cell beside gets flat."""
    found = pile([1, 1, 1, 1, 1], np.array([0.1, 0.2, -part]) * HEIGHT / DT)
    assert left(found)[0] == pytest.approx(1 - part)
    (before, energy), others = of_particles(found), found.fields[:, 3:].copy()
    stop_flattening(found, DENSITY, DT)
    assert STOPPED - 2e-3 < left(found)[0] < 0.95
    assert left(found).min() > FLAT - 2e-3
    momentum, rest = of_particles(found)
    np.testing.assert_allclose(momentum, before, rtol=1e-12, atol=1e-9 * abs(before[2]))
    assert 0.1 * energy < rest < 0.9 * energy
    np.testing.assert_array_equal(found.fields[:, 3:], others)


@pytest.mark.parametrize(("part", "label"), [(0.5, 1), (1.5, 0)])
def test_what_comes_close_slowly_and_empty_space_are_left_alone(part, label):
    found = pile([label, 0, 0, 0, 0], np.array([0, 0, -part]) * HEIGHT / DT)
    before = found.fields.copy()
    stop_flattening(found, DENSITY, DT)
    np.testing.assert_array_equal(found.fields, before)


def test_held_particles_take_what_stops_the_others():
    found = pile([1, 1, 1, 1, 1], np.array([0, 0, -1.2]) * HEIGHT / DT)
    found.marks[:3] |= 2
    stop_flattening(found, DENSITY, DT)
    assert STOPPED - 2e-3 < left(found)[0] < 0.95
    assert not found.fields[:3].any()
    assert found.fields[3, 2] == pytest.approx(-(1 - STOPPED) * HEIGHT / DT, rel=0.05)


@pytest.mark.parametrize(("part", "ahead", "label"), [(0.7, DT, 0), (0.9, DT, 1), (0.9, 0.0, 0), (0.9, 0.8 * DT, 0)])
def test_empty_space_that_closes_within_a_step_goes_to_the_fluid(part, ahead, label):
    """It is no film: it is a tetrahedron of equal sides, with empty space below."""
    found = pile([0, 1, 1, 1, 0], np.array([0, 0, -part]) * HEIGHT / DT)
    found.round(Task(RELABEL, 1, 0.3, ahead=ahead))
    assert found.label[0] == label
    assert (found.label[1:5] == [1, 1, 1, 0]).all()


def test_what_meets_late_in_a_step_stays_there():
    """Where more of the step is left, it is refused."""
    mesh = Mesh(pile([0] * 5, np.zeros(3)).x[:4], np.arange(4, dtype=np.int32)[None])
    held = Slipping(np.zeros(0, dtype=np.int32), np.zeros((0, 3, 3)), np.zeros((4, 6), dtype=bool), np.arange(6))
    way = np.array([[0, 0, 0], [0, 0, 0], [0, 0, 0], [0.1, 0, -HEIGHT]])
    found = followed(mesh, mesh.position + way / 0.9, 1.0, held)
    assert 0 < found.measure[0] < 0.03 * mesh.measure[0]
    np.testing.assert_allclose(found.position, mesh.position + way, atol=0.02)
    with pytest.raises(TriangulationError, match="meet in the step"):
        followed(mesh, mesh.position + way / 0.6, 1.0, held)
