"""Grading in three dimensions: tetrahedra follow the targets, and what is at rest stays."""

import numpy as np
import pytest

import tipfem as tp
from tipfem.backend.launch import launch
from tipfem.geometry.period import no_period
from tipfem.remesh.gradation import limit_gradation

WATER = tp.Fluid("water", density=1000.0, viscosity=1e-3)
AIR = tp.Fluid("air", density=1.2, viscosity=1.8e-5)
GRAVITY = (0.0, 0.0, -9.81)
H = 0.05


def case(kind: str, largest: float | None = 4 * H, **options) -> tp.Case:
    """Water in a box, a blocked one or one with a slope, below air or a free surface."""
    if kind == "slope":
        tank = tp.tank(
            shape=tp.solids.prism([(0, 0), (0.8, 0), (1.2, 0.6), (0, 0.6)], 0.6, along="y"), spacing=H, jitter=0.1
        )
    else:
        tank = tp.tank((1.0, 0.6, 0.8), H, jitter=0.1)
    if kind == "block":
        tank.block("block", ((0.4, 0.2, 0.0), (0.6, 0.4, 0.2)))
    fluids = [WATER, AIR] if kind == "air" else [WATER]
    if kind == "air":
        tank.fill(AIR)
    tank.fill(WATER, box=((0, 0, 0), (1.2, 0.6, 0.4)))
    grading = None if largest is None else tp.Grading({fluid.name: largest for fluid in fluids}, **options)
    return tp.Case(tank, fluids, GRAVITY, grading=grading, free_surface=kind != "air")


def edges(mesh) -> np.ndarray:
    """(E, 2) of the cells of fluids."""
    pairs = np.concatenate([mesh.cells[:, [i, j]] for j in range(4) for i in range(j)])
    return np.unique(np.sort(pairs, axis=1), axis=0)


def test_growth_is_limited_along_every_edge_of_tetrahedra():
    mesh = tp.Simulation(case("air", None)).mesh
    wish = np.random.default_rng(1).uniform(H, 1.0, len(mesh.position))
    pairs = np.concatenate([edges(mesh), edges(mesh)[:, ::-1]])
    length = np.linalg.norm(mesh.position[pairs[:, 0]] - mesh.position[pairs[:, 1]], axis=1)
    expected = wish.copy()
    for _ in range(100):
        np.minimum.at(expected, pairs[:, 0], expected[pairs[:, 1]] + 0.2 * length)
    given = mesh.position, mesh.cells, no_period(3).array, wish, np.zeros(len(wish), dtype=np.int32), 0.2, 3
    assert launch(limit_gradation, *given) < 100
    np.testing.assert_allclose(wish, expected, rtol=1e-8)


@pytest.mark.parametrize("kind", ["air", "free", "block", "slope"])
def test_water_at_rest_stays_and_is_coarse_away_from_faces(kind):
    simulation = tp.Simulation(case(kind))
    particles, volume, cells = simulation.particles, simulation.state.volume, simulation.mesh.cells
    assert len(particles) < 0.8 * len(tp.Simulation(case(kind, None)).particles)
    assert particles.target.max() > 1.8 * H
    pairs = edges(simulation.mesh)
    length = np.linalg.norm(particles.position[pairs[:, 0]] - particles.position[pairs[:, 1]], axis=1)
    ratio = length / particles.target[pairs].mean(axis=1)
    assert 0.3 < ratio.min() < 0.8
    assert 1.5 < ratio.max() < 2.4
    for _ in range(3):
        simulation.step()
    np.testing.assert_array_equal(simulation.mesh.cells, cells)
    assert np.abs(simulation.particles.velocity).max() < 1e-9
    np.testing.assert_allclose(simulation.state.volume, volume, rtol=1e-13)


def test_a_function_of_places_refines_there():
    coarse, fine = (
        tp.Simulation(case("air", where=where)).particles for where in (None, lambda x: np.where(x[:, 2] > 0.7, H, 1.0))
    )
    near = [(particles.position[:, 2] > 0.72).sum() for particles in (coarse, fine)]
    assert near[1] > 3 * near[0]


@pytest.mark.parametrize("kind", ["air", "free"])
def test_a_drop_in_a_coarse_place_has_its_volume(kind):
    simulation = tp.Simulation(case(kind))
    volume = simulation.state.volume[0]
    simulation.steer(tp.Drop(at=(0.5, 0.3, 0.6), radius=0.11, fluid="water"))
    simulation.step()
    assert 0.85 < (simulation.state.volume[0] - volume) / (4 / 3 * np.pi * 0.11**3) < 1.0


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["air", "free"])
def test_a_column_collapses_as_without_grading(kind):
    """Front and energies until the far wall within 3 %, with less than half of the particles."""
    rows = []
    for largest in (None, 4 * 0.04):
        tank = tp.tank((1.0, 0.4, 0.8), 0.04, jitter=0.1)
        fluids = [WATER, AIR] if kind == "air" else [WATER]
        if kind == "air":
            tank.fill(AIR)
        tank.fill(WATER, box=((0, 0, 0), (0.4, 0.4, 0.5)))
        grading = None if largest is None else tp.Grading({fluid.name: largest for fluid in fluids})
        flow = tp.Simulation(tp.Case(tank, fluids, GRAVITY, grading=grading, free_surface=kind != "air"))
        volume = flow.state.volume
        flow.run(0.22, progress=False)
        np.testing.assert_allclose(flow.state.volume, volume, rtol=1e-12)
        wet = flow.mesh.position[flow.mesh.cells[flow.mesh.fluid == 0]]
        row = flow.history[-1]
        rows.append([wet[..., 0].max(), row["kinetic_energy"], row["potential_energy"], len(flow.particles)])
    np.testing.assert_allclose(rows[1][:3], rows[0][:3], rtol=0.03)
    assert rows[1][3] < 0.5 * rows[0][3]
