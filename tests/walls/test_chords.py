"""Walls of chords that slide, of polygons and of meshes, against the flow between two cylinders."""

import meshio
import numpy as np
import pytest

import tipfem as tp

INNER, OUTER, SPEED, CORNERS, ROWS = 0.5, 1.0, 1.0, 32, 6
SYRUP = tp.Fluid("water", density=1000.0, viscosity=1e4)


def ring(radius: float) -> np.ndarray:
    """Corners (CORNERS, 2) on a circle."""
    angle = 2 * np.pi * np.arange(CORNERS) / CORNERS
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def mesh_file(path) -> str:
    """A mesh between the circles, with names for both."""
    points = np.concatenate([ring(r) for r in np.linspace(INNER, OUTER, ROWS + 1)])
    k = np.arange(CORNERS)
    on = (k + 1) % CORNERS
    cells = np.concatenate(
        [np.concatenate([np.stack([a + k, b + k, b + on], 1), np.stack([a + k, b + on, a + on], 1)])
         for a, b in ((CORNERS * row, CORNERS * (row + 1)) for row in range(ROWS))]
    )  # fmt: skip
    edges = [np.stack([first + k, first + on], axis=1) for first in (0, CORNERS * ROWS)]
    groups = [np.full(len(cells), 1), np.full(CORNERS, 2), np.full(CORNERS, 3)]
    mesh = meshio.Mesh(
        np.column_stack([points, np.zeros(len(points))]),
        [("triangle", cells), ("line", edges[0]), ("line", edges[1])],
        cell_data={"gmsh:physical": groups, "gmsh:geometrical": groups},
        field_data={"water": np.array([1, 2]), "inner": np.array([2, 1]), "outer": np.array([3, 1])},
    )
    meshio.write(path, mesh, file_format="gmsh22", binary=False)
    return str(path)


def polygon() -> tp.Tank:
    """The same by shapes, of straight sides."""
    hole = tp.shapes.polygon(ring(INNER).tolist(), names=["inner"] * CORNERS)
    shape = tp.shapes.polygon(ring(OUTER).tolist(), names=["outer"] * CORNERS, holes=[hole])
    return tp.tank(shape=shape, spacing=0.1).fill(SYRUP)


@pytest.mark.parametrize("velocity", [SPEED, lambda t: SPEED], ids=["number", "function"])
@pytest.mark.parametrize("kind", ["mesh", "polygon"])
def test_the_flow_between_cylinders_is_that_of_couette(tmp_path, kind, velocity):
    tank = tp.read_mesh(mesh_file(tmp_path / "annulus.msh")) if kind == "mesh" else polygon()
    tank.wall("inner", velocity=velocity, law="no-slip").wall("outer", law="no-slip")
    simulation = tp.Simulation(tp.Case(tank, [SYRUP], (0, 0)), time_step=0.02)
    for _ in range(15):
        simulation.step()
    x, u = simulation.particles.position, simulation.particles.velocity
    r = np.linalg.norm(x, axis=1)
    swirl = (x[:, 0] * u[:, 1] - x[:, 1] * u[:, 0]) / r
    b = SPEED * INNER / (1 - (INNER / OUTER) ** 2)
    inner = np.abs(r - INNER) < 0.02
    np.testing.assert_allclose(np.abs(swirl[inner]), SPEED, rtol=1e-6)
    np.testing.assert_allclose(np.abs(swirl), b * (1 / r - r / OUTER**2), atol=0.03 * SPEED)
    assert simulation.volume("water") == pytest.approx(
        0.5 * CORNERS * np.sin(2 * np.pi / CORNERS) * (OUTER**2 - INNER**2), rel=1e-9
    )
