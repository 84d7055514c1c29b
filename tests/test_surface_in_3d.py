"""Free surfaces in 3-D: first meshes of boxes, water at rest, and a dam break without a refused step."""

from __future__ import annotations

import numpy as np
import pytest

import tipfem as tp
from tipfem.mesh.mesh import Mesh
from tipfem.remesh.cavity.following import qualities

WATER = tp.Fluid("water", density=1000.0, viscosity=1e-3)
# Number of spacings along the tank, depth [m], jitter, and the axis along which gravity points.
POOLS = [(6, 0.5, 0.1, 2), (7, 0.43, 0.2, 2), (6, 0.5, 0.1, 0)]


def pool(count: int, depth: float, jitter: float, axis: int, **wall) -> tp.Simulation:
    """Water at rest in a tank of 1 x 1 x 0.8 m, the last along gravity."""
    size, upper, gravity = np.ones(3), np.ones(3), np.zeros(3)
    size[axis], upper[axis], gravity[axis] = 0.8, depth, -9.81
    tank = tp.tank(size, 1 / count, jitter=jitter).fill(WATER, box=((0, 0, 0), upper))
    for side in tank.sides if wall else ():
        tank.wall(side, **wall)
    return tp.Simulation(tp.Case(tank, [WATER], gravity, free_surface=True), time_step=4e-3)


def covered(mesh: Mesh, axis: int, at: float) -> float:
    """Area of the faces of one cell only that are on a plane [m^2]."""
    face = np.sort(np.concatenate([np.delete(mesh.cells, i, axis=1) for i in range(4)]), axis=1)
    face, times = np.unique(face, axis=0, return_counts=True)
    corner = mesh.position[face[times == 1]]
    corner = corner[(np.abs(corner[:, :, axis] - at) < 1e-9).all(axis=1)]
    side = corner[:, 1:] - corner[:, :1]
    return float(0.5 * np.linalg.norm(np.cross(side[:, 0], side[:, 1]), axis=1).sum())


@pytest.mark.parametrize(("count", "depth", "jitter", "axis"), [*POOLS, (10, 0.52, 0.05, 1)])
def test_the_first_mesh_of_a_box_is_the_box(count, depth, jitter, axis):
    mesh = pool(count, depth, jitter, axis).mesh
    assert mesh.measure.sum() == pytest.approx(depth, rel=1e-14)
    for k in range(3):
        for at in (0.0, 1.0):
            if k != axis:
                assert covered(mesh, k, at) == pytest.approx(depth, rel=1e-12)
    assert covered(mesh, axis, 0.0) == pytest.approx(1.0, rel=1e-12)
    assert covered(mesh, axis, depth) == pytest.approx(1.0, rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("case", "wall"),
    [
        (POOLS[0], {"law": "no-slip"}),
        (POOLS[1], {"law": "no-slip"}),
        (POOLS[1], {}),  # with layers
        (POOLS[2], {"slip": True}),
    ],
)
def test_water_at_rest_stays_at_rest(case, wall):
    """After a step no cell changes; the tank stays covered below the level, and pressure is that of the depth."""
    _, depth, _, axis = case
    pool_at_rest = pool(*case, **wall)
    pool_at_rest.step()
    before = np.unique(np.sort(pool_at_rest.mesh.cells, axis=1), axis=0)
    while pool_at_rest.time < 0.4 - 1e-9:
        pool_at_rest.step(0.4)
        assert pool_at_rest.particles.max_speed < 1e-9
    mesh, particles = pool_at_rest.mesh, pool_at_rest.particles
    np.testing.assert_array_equal(np.unique(np.sort(mesh.cells, axis=1), axis=0), before)
    assert covered(mesh, axis, 0.0) == pytest.approx(1.0, rel=1e-9)
    deep = 9810 * (depth - particles.position[mesh.used, axis])
    np.testing.assert_allclose(particles.pressure[mesh.used], deep, atol=1e-4)


@pytest.mark.slow(but=("layer-0.08",))
@pytest.mark.parametrize(("law", "lost"), [("no-slip", 0.5), ("layer", 0.08)])
def test_a_dam_breaks_without_a_refused_step(law, lost):
    """Its cells keep their quality and its water its volume; walls with layers take less of its energy."""
    tank = tp.tank((1.5, 0.5, 1.0), 0.1, jitter=0.1).fill(WATER, box=((0, 0, 0), (0.5, 0.5, 0.5)))
    for side in tank.sides:
        tank.wall(side, law=law)
    dam = tp.Simulation(tp.Case(tank, [WATER], (0, 0, -9.81), free_surface=True), time_step=4e-3)
    volume, worst = dam.volume("water"), 1.0
    while dam.time < 0.2 - 1e-9:
        dam.step(0.2)
        worst = min(worst, float(qualities(dam.mesh).min()))
    assert sum(row["refused_steps"] for row in dam.history) == 0
    assert dam.volume("water") == pytest.approx(volume, rel=1e-12)
    assert worst > 0.01
    assert dam.numerical_error()["energy"] < lost
