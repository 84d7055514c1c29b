"""Triangulations to test remeshing with, and what must hold of every one of them."""

import numpy as np
import taichi as ti
from scipy.spatial import Delaunay

from tipfem.backend.array_types import Ints1, Ints2, Periods, Reals2
from tipfem.backend.launch import kernel, launch
from tipfem.mesh.mesh import Mesh, simplex_measure
from tipfem.remesh.triangles import edge_operations
from tipfem.remesh.triangles.edge_operations import ACCELERATION, COLUMNS, MASS, TARGET, VELOCITY
from tipfem.remesh.triangles.triangulation import Triangulation
from tipfem.remesh.volumes import label_components

CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


def of(position, cells, fluid=None, *, wall=None, density=None) -> Triangulation:
    """A triangulation of one fluid, or of those given, at rest; particles on the hull are walls unless told."""
    cells = np.ascontiguousarray(cells, dtype=np.int32)
    mesh = Mesh(position, cells)
    state = np.zeros((len(position), COLUMNS))
    state[:, :2] = position
    state[:, TARGET] = 1.0
    corner = np.full(len(position), -1, dtype=np.int32)
    corner[cells.ravel()] = np.arange(cells.size, dtype=np.int32) // 3
    fluid = np.zeros(len(cells), dtype=np.int32) if fluid is None else np.array(fluid, dtype=np.int32)
    if wall is None:
        wall = np.zeros(len(position))
        cell, i = np.nonzero(mesh.neighbours < 0)
        wall[cells[cell, (i + 1) % 3]] = wall[cells[cell, (i + 2) % 3]] = 1
    density = np.ones(fluid.max() + 1) if density is None else np.array(density, dtype=float)
    t = Triangulation(
        state, cells.copy(), mesh.neighbours.copy(), fluid, corner, np.array(wall, dtype=np.int32), density
    )
    t.state[:, MASS] = masses(t)
    return t


@kernel
def flip_edges(
    x: Reals2,
    cells: Ints2,
    neighbours: Ints2,
    fluid: Ints1,
    corner: Ints1,
    period: Periods,
    edges: Ints1,
    flat: ti.f64,
    count: Ints1,
):
    """Flip those of ``edges`` (3 * cell + corner) that lie in one fluid and in a convex quadrilateral."""
    mesh = ti.static(edge_operations.TriangleArrays(x, cells, neighbours, fluid, period, corner))
    ti.loop_config(serialize=True)
    for k in range(edges.shape[0]):
        t, i = edges[k] // 3, edges[k] % 3
        o = neighbours[t, i]
        if o >= 0:
            a, b, c = cells[t, i], cells[t, (i + 1) % 3], cells[t, (i + 2) % 3]
            d = cells[o, edge_operations.column_of(neighbours, o, t)]
            one, other = edge_operations.double_area(mesh, a, b, d), edge_operations.double_area(mesh, a, d, c)
            convex = one > flat and other > flat
            if fluid[o] == fluid[t] and convex:
                edge_operations.flip(mesh, t, i)
                count[0] += 1


def shuffled(t: Triangulation, seed: int) -> int:
    """Flip edges at random; how many."""
    count = np.zeros(1, dtype=np.int32)
    edges = np.random.default_rng(seed).permutation(np.tile(np.arange(t.cells.size, dtype=np.int32), 3))
    flat = 1e-10 * float(np.ptp(t.state[:, 1]))
    launch(flip_edges, t.state, t.cells, t.neighbours, t.fluid, t.corner, t.period.array, edges, flat, count)
    return int(count[0])


def masses(t: Triangulation) -> np.ndarray:
    """(N,) a third of the mass of each triangle around."""
    alive = t.fluid >= 0
    share = t.density[t.fluid[alive]] * simplex_measure(np.ascontiguousarray(t.state[:, :2]), t.cells[alive]) / 3
    return np.bincount(t.cells[alive].ravel(), weights=np.repeat(share, 3), minlength=len(t.state))


def momentum(t: Triangulation) -> np.ndarray:
    """(2,) of all particles, by the masses of their triangles."""
    return masses(t) @ t.state[:, VELOCITY:ACCELERATION]


def momentum_scale(t: Triangulation) -> float:
    """Size of the terms of which a momentum is the sum."""
    return float(np.abs(t.state[:, MASS:TARGET] * t.state[:, VELOCITY:ACCELERATION]).sum())


def areas(t: Triangulation) -> np.ndarray:
    """Of each fluid."""
    return np.bincount(t.fluid, weights=simplex_measure(np.ascontiguousarray(t.state[:, :2]), t.cells))


def grid(x, y) -> tuple[np.ndarray, np.ndarray]:
    """Lattice points on the lines ``x`` and ``y``, and its squares, each cut into two triangles."""
    position = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2).astype(float)
    index = np.arange(len(position)).reshape(len(x), len(y))
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    cells = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)], axis=2).reshape(-1, 3)
    return position, cells


def delaunay(x) -> np.ndarray:
    """Qhull's triangles, counter-clockwise, without those that have no area; points 0 to 3 span the hull."""
    cells = Delaunay(x).simplices.astype(np.int32)
    measure = simplex_measure(x, cells)
    cells[measure < 0] = cells[measure < 0][:, ::-1]
    return cells[np.abs(measure) > 1e-14]


def check(t: Triangulation, removed: int = 0) -> None:
    """All that must hold of a triangulation whose ``removed`` particles have no cells."""
    alive = t.fluid >= 0
    cells = t.cells[alive]
    number = np.where(alive, np.cumsum(alive) - 1, -1)
    x = np.ascontiguousarray(t.state[:, :2])
    np.testing.assert_array_equal(
        np.where(t.neighbours[alive] >= 0, number[t.neighbours[alive]], -1), Mesh(x, cells).neighbours, "neighbours"
    )
    assert (simplex_measure(x, cells) > 0).all()
    used = np.unique(cells)
    np.testing.assert_array_equal(np.flatnonzero(t.corner >= 0), used)
    assert (t.cells[t.corner[used]] == used[:, None]).any(axis=1).all()
    assert alive[t.corner[used]].all()
    assert len(used) == len(x) - removed
    hull = int((t.neighbours[alive] < 0).sum())
    assert len(cells) == 2 * len(used) - 2 - hull  # Euler, of a disc


def as_set(cells) -> set[tuple[int, ...]]:
    """Cells without their order."""
    return set(map(tuple, np.sort(cells, axis=1).tolist()))


def border(t: Triangulation, hull: bool = False) -> np.ndarray:
    """The edges (K, 2) between two fluids, or those of the hull."""
    cell, i = np.nonzero(
        t.neighbours < 0 if hull else (t.neighbours >= 0) & (t.fluid[t.neighbours] != t.fluid[:, None])
    )
    return np.stack([t.cells[cell, (i + 1) % 3], t.cells[cell, (i + 2) % 3]], axis=1)


def inner_edges(t: Triangulation):
    """The four particles (K, 4) around each inner edge of one fluid: those of a cell, and the one beyond."""
    cell, i = np.nonzero(
        (t.neighbours > np.arange(len(t.cells))[:, None]) & (t.fluid[t.neighbours] == t.fluid[:, None])
    )
    o = t.neighbours[cell, i]
    j = np.argmax(t.neighbours[o] == cell[:, None], axis=1)
    four = np.stack([t.cells[cell, i], t.cells[cell, (i + 1) % 3], t.cells[cell, (i + 2) % 3], t.cells[o, j]], axis=1)
    return four.astype(np.int32)


def circle_test(x, four) -> np.ndarray:
    """How far the fourth lies inside the circle through the others, over the size of the four, in NumPy."""
    v = x[four[:, :3]] - x[four[:, 3:]]
    square = (v**2).sum(axis=2)
    return np.linalg.det(np.concatenate([v, square[..., None]], axis=2)) / square.max(axis=1) ** 2


def cloud(kind: str, seed: int) -> np.ndarray:
    """Points (N, 2) inside and on a unit square (or a stretched one) whose corners come first."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(5, 60))
    x = rng.uniform(0.02, 0.98, (n, 2))
    if kind == "clustered":
        x = np.clip(0.5 + 10 ** rng.uniform(-4, -0.5, (n, 1)) * rng.normal(size=(n, 2)), 0.01, 0.99)
    elif kind == "circles":
        angle = rng.uniform(0, 2 * np.pi, n)
        radius = 0.1 * rng.integers(1, 5, n) * (1 + 1e-9 * rng.normal(size=n))
        x = 0.5 + radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    elif kind in ("lattice", "jittered lattice"):
        x = np.stack(np.meshgrid(np.arange(1, 8), np.arange(1, 8)), axis=-1).reshape(-1, 2) / 8
        if kind == "jittered lattice":
            x = x + rng.uniform(-0.2, 0.2, x.shape) / 8
    elif kind == "walls":
        wall = np.sort(rng.uniform(0.01, 0.99, (4, 6)), axis=1)
        side = [np.stack([wall[0], 0 * wall[0]], 1), np.stack([wall[1], 0 * wall[1] + 1], 1)]
        side += [np.stack([0 * wall[2], wall[2]], 1), np.stack([0 * wall[3] + 1, wall[3]], 1)]
        near = np.stack([wall[0] + 0.005, 10 ** rng.uniform(-6, -2, 6)], 1)
        x = np.concatenate([x, *side, near])
    stretch = {"thin": (1.0, 1e-3), "stretched": (1.0, 10.0)}.get(kind, (1.0, 1.0))
    return np.concatenate([CORNERS, x]) * stretch


def component_labels(neighbours, fluid) -> np.ndarray:
    """Connected component (M,) of one fluid that each cell belongs to."""
    nowhere = np.zeros((1, 2))
    return label_components(nowhere, np.zeros_like(neighbours), neighbours, fluid, int(fluid.max()) + 1)[0].label


KINDS = ["random", "clustered", "circles", "lattice", "jittered lattice", "walls", "thin", "stretched"]
