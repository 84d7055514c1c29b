"""Films and sheets thinner than the spacing: edges as short as these are thick, where a grading asks for that."""

import re

import numpy as np
import pytest

import tipfem as tp
from tipfem.mesh.mesh import Mesh
from tipfem.remesh.target_spacing import film_targets

WATER = tp.Fluid("water", density=1000.0, viscosity=1e-3)
AIR = tp.Fluid("air", density=1.2, viscosity=1.8e-5)
H, RATE = 0.01, 2.0  # spacing [m], rate of stretching at the start [1/s]


def sheet(grading: tp.Grading | None, dimension: int = 2) -> tp.Simulation:
    """A sheet of two spacings that is stretched: without pressure, each particle keeps its velocity along it."""
    half, thick = (0.1, 0.01) if dimension == 2 else (0.05, 0.01)
    size = np.array([1.0, 0.1]) if dimension == 2 else np.array([0.3, 0.3, 0.08])
    across, middle = np.eye(dimension)[-1], size / 2
    reach = np.where(across > 0, thick, half)
    rates = RATE * (1 - dimension * across)  # without change of volume

    def velocity(x):
        return (x - middle) * rates

    options = {"jitter": 0.2} if dimension == 3 else {}
    tank = tp.tank(size, H, **options).fill(WATER, box=(middle - reach, middle + reach), velocity=velocity)
    case = tp.Case(tank, [WATER], (0,) * dimension, free_surface=True, grading=grading)
    return tp.Simulation(case, time_step=0.01 if dimension == 2 else 0.005)


def thickness(simulation: tp.Simulation) -> tuple[float, float]:
    """Mean thickness in the middle of the sheet, and its height in all there [spacings]."""
    mesh = simulation.mesh
    middle, along = np.array([0.5, 0.05]), 0.05 * (1 + RATE * simulation.time)
    here = np.abs(mesh.position[mesh.cells][:, :, 0].mean(axis=1) - middle[0]) < along
    y = mesh.position[mesh.cells[here], 1]
    return mesh.measure[here].sum() / (2 * along) / H, np.ptp(y) / H


def test_a_sheet_stretched_to_a_third_of_a_spacing_stays_whole_and_smooth():
    """Exact: thickness and rate of stretching fall as 1 / (1 + a t)."""
    simulation, coarse = runs = sheet(tp.Grading(film_resolution=0.1 * H)), sheet(None)
    volume = simulation.state.volume
    for run in runs:
        run.run(1.5, progress=False)
    exact = 2.0 / (1 + RATE * simulation.time)
    mean, height = thickness(simulation)
    assert mean == pytest.approx(exact, rel=0.01)
    assert height < 2.0 * exact
    assert thickness(coarse)[1] > 1.5 * height  # a zigzag of long edges
    np.testing.assert_allclose(simulation.state.volume, volume, rtol=1e-11)
    mesh, target = simulation.mesh, simulation.particles.target
    assert not mesh.surface.loose.any()
    pairs = mesh.cells[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    length = np.linalg.norm(mesh.position[pairs[:, 0]] - mesh.position[pairs[:, 1]], axis=1)
    assert np.quantile(length, 0.95) < 2.2 * exact * H
    assert 0.1 * H <= target.min() < 1.1 * exact * H
    assert target[mesh.surface.front].max() <= H


@pytest.mark.slow
def test_a_sheet_in_space_keeps_the_energy_of_its_stretching():
    fine, coarse = runs = sheet(tp.Grading(film_resolution=0.2 * H), 3), sheet(None, 3)
    lost = []
    for run in runs:
        before = run.energy().kinetic
        run.run(0.5, progress=False)
        lost.append(1 - run.energy().kinetic / before)
    assert 0 <= lost[0] < 0.03
    assert lost[0] < 0.6 * lost[1]
    assert not fine.mesh.surface.loose.any()
    assert fine.mesh.measure.min() > 0
    assert len(fine.mesh.cells) > 2 * len(coarse.mesh.cells)


@pytest.mark.parametrize("angle", [0.0, 0.7])
def test_targets_are_the_height_of_what_is_thin_alone(angle):
    """A strip of triangles and a wide block of the same fluid, with the other one around, however they are turned."""
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    x = np.arange(11.0)
    rows = [-6.0, -5.0, -4.0, -3.0, 0.0, 0.2, 3.0]
    position = np.concatenate([np.column_stack([x, np.full(11, y)]) for y in rows]) @ turn.T
    cells, fluid = [], []
    for row in range(len(rows) - 1):
        for column in range(10):
            a, c = 11 * row + column, 11 * (row + 1) + column
            cells += [[a, a + 1, c], [a + 1, c + 1, c]]
            fluid += [1, 1] if row in (0, 1, 2, 4) else [0, 0]
    mesh = Mesh(position, np.array(cells, dtype=np.int32), np.array(fluid, dtype=np.int32))
    free = np.isin(np.arange(len(position)) // 11, (3, 4, 5))
    given = mesh.position, mesh.cells, mesh.neighbours, np.asarray(mesh.fluid), np.array([False, True])
    target = film_targets(*given, free, np.ones(len(position)), 0.05)
    strip = np.isin(np.arange(len(position)) // 11, (4, 5))
    np.testing.assert_allclose(target[strip], 0.2, rtol=1e-12)
    np.testing.assert_array_equal(target[~strip], 1.0)
    finest = film_targets(*given, free, np.ones(len(position)), 0.5)
    np.testing.assert_array_equal(finest[strip], 0.5)


@pytest.mark.parametrize("given", [{}, {"free_surface": True}])
def test_water_at_rest_stays_with_a_resolution_of_films(given):
    tank = tp.tank((0.4, 0.3), 0.02).fill(WATER, box=((0, 0), (0.4, 0.15)))
    tank = tank if given else tank.fill(AIR, box=((0, 0.15), (0.4, 0.3)))
    fluids = [WATER] if given else [WATER, AIR]
    simulation = tp.Simulation(tp.Case(tank, fluids, (0.0, -9.81), grading=tp.Grading(film_resolution=0.002), **given))
    cells = simulation.mesh.cells
    simulation.run(0.1, progress=False)
    np.testing.assert_array_equal(simulation.mesh.cells, cells)
    assert np.abs(simulation.particles.velocity).max() < 1e-9


@pytest.mark.parametrize("value", [0.0, -1.0, "thin", 0.021, 0.05, 1.9e-4])
def test_a_resolution_that_is_none_is_refused(value):
    def make():
        tank = tp.tank((0.4, 0.3), 0.02).fill(AIR).fill(WATER, box=((0, 0), (0.4, 0.15)))
        return tp.Case(tank, [WATER, AIR], (0.0, -9.81), grading=tp.Grading(film_resolution=value))

    with pytest.raises(ValueError, match="film_resolution is " + re.escape(repr(value))):
        make()
