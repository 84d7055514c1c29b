"""tipfem/triangulation.py and tipfem/mesh.py: the mesh against brute force."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from mesh_twins import adjacency
from scipy.spatial import ConvexHull

import tipfem as tp
from tipfem.errors import TriangulationError
from tipfem.mesh import delaunay as triangulation
from tipfem.mesh.delaunay import delaunay, triangulate, wall_fluid
from tipfem.mesh.mesh import Mesh, simplex_measure


def cloud(dimension: int, seed: int = 0, jitter: float = 0.3) -> tp.Particles:
    """A jittered tank, two fluids, at random sides of a slanted plane."""
    water, air = tp.Fluid("water", 1000.0, 1e-3), tp.Fluid("air", 1.0, 1e-5)
    n = 9 if dimension == 2 else 5
    tank = tp.tank((1.0,) * dimension, 1 / n, jitter=jitter, seed=seed).fill(air)
    return tank.fill(water, where=lambda x: x[:, 0] + 0.5 * x[:, 1] < 0.8).sample([water, air])


def mesh_of(p: tp.Particles) -> Mesh:
    """Its mesh."""
    return triangulate(p.position, p.wall, p.spacing)


def sorted_cells(mesh: Mesh) -> set[tuple[int, ...]]:
    """The cells as sets of particles."""
    return {tuple(sorted(cell)) for cell in mesh.cells.tolist()}


def circumcircle(corner: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre and radius of the sphere through a simplex' corners (d + 1, d)."""
    side = corner[1:] - corner[0]
    centre = corner[0] + np.linalg.solve(2 * side, (side**2).sum(axis=1))
    return centre, float(np.linalg.norm(centre - corner[0]))


def test_hulls_that_are_not_flat_are_filled_whatever_volume_is_known(monkeypatch):
    """Points around a cloud would take cells at its hull; around a box, they take the flat ones alone."""
    calls = list[int]()
    strained = triangulation._strained
    monkeypatch.setattr(triangulation, "_strained", lambda *given: calls.append(len(given)) or strained(*given))
    x = np.random.default_rng(1).random((60, 3))
    volume = ConvexHull(x).volume
    cells, measure, neighbours = delaunay(x, 0.2, volume=volume)
    assert measure.sum() * 0.2**3 == pytest.approx(volume, rel=1e-12)
    assert calls == [2, 1]
    p = cloud(3)
    cells, measure, neighbours = delaunay(p.position, p.spacing, volume=1.0)
    assert calls == [2, 1, 2]
    assert measure.min() > 1e-4
    np.testing.assert_array_equal(neighbours, Mesh(p.position, cells).neighbours)


@pytest.mark.parametrize(("dimension", "known"), [(2, False), (3, False), (3, True)])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_cells_are_positive_fill_the_hull_use_all_particles_and_are_delaunay(dimension, known, seed):
    """Also where the volume of the hull is known, so that Qhull has points around the tank."""
    p = cloud(dimension, seed)
    mesh = triangulate(p.position, p.wall, p.spacing, volume=ConvexHull(p.position).volume if known else None)
    assert mesh.cells.dtype == np.int32
    assert mesh.cells.shape[1] == dimension + 1
    assert mesh.dimension == dimension
    assert (np.diff(mesh.cells.min(axis=1)) >= 0).all()
    assert (mesh.measure > 0).all()
    assert mesh.measure.sum() == pytest.approx(ConvexHull(p.position).volume, rel=1e-12)
    assert np.unique(mesh.cells).tolist() == list(range(len(p)))
    assert len(sorted_cells(mesh)) == len(mesh.cells)
    for cell in mesh.cells:
        centre, radius = circumcircle(p.position[cell])
        inside = np.linalg.norm(p.position - centre, axis=1) < radius * (1 - 1e-9)
        assert not inside[np.setdiff1d(np.arange(len(p)), cell)].any()


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("seed", [3, 4, 5])
def test_every_inner_facet_joins_two_cells_and_the_rest_is_the_boundary(dimension, seed):
    p = cloud(dimension, seed)
    mesh = mesh_of(p)
    count: dict[tuple[int, ...], int] = {}
    for cell in mesh.cells.tolist():
        for facet in itertools.combinations(sorted(cell), dimension):
            count[facet] = count.get(facet, 0) + 1
    assert set(count.values()) == {1, 2}
    outer = np.array([facet for facet, k in count.items() if k == 1])
    assert p.wall[outer].all()
    same_side = [(p.position[outer, k] == side).all(axis=1) for k in range(dimension) for side in (0.0, 1.0)]
    assert np.any(same_side, axis=0).all()


def test_a_measure_is_half_or_a_sixth_of_the_determinant():
    rng = np.random.default_rng(2)
    for d, factor in ((2, 2), (3, 6)):
        x = rng.normal(size=(20, d))
        cells = np.array([rng.permutation(20)[: d + 1] for _ in range(30)])
        expected = [np.linalg.det(x[c[1:]] - x[c[0]]) / factor for c in cells]
        np.testing.assert_allclose(simplex_measure(x, cells), expected, rtol=1e-10, atol=1e-14)


@pytest.mark.parametrize("shift", [(0.0, 0.0), (1e6, -1e6), (-3e7, 0.0)])
def test_slivers_along_straight_walls_are_dropped(shift):
    # A tilted tank: round-off puts the wall particles beside their line, and thin triangles between them.
    p = cloud(2, seed=3)
    angle = 0.3
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    position = p.position @ turn.T + shift
    mesh = triangulate(position, p.wall, p.spacing)
    assert (mesh.measure > 1e-6 * p.spacing**2).all()
    assert mesh.measure.sum() == pytest.approx(1.0, rel=1e-6)
    assert np.unique(mesh.cells).tolist() == list(range(len(p)))
    if shift == (0.0, 0.0):
        assert sorted_cells(mesh) == sorted_cells(mesh_of(p))


def test_a_thin_triangle_of_wall_particles_is_a_sliver_only_if_it_is_flat():
    position = np.array([[0, 0], [1, -1e-8], [2, 0], [1, 1], [0, 2], [2, 2]], dtype=float)
    wall = np.array([True, True, True, False, True, True])
    assert (0, 1, 2) not in sorted_cells(triangulate(position, wall, 1.0))
    position[1, 1] = 1e-8
    flat = triangulate(position, wall, 1.0)
    assert (0, 1, 2) not in sorted_cells(flat)
    assert flat.measure.sum() == pytest.approx(4.0, rel=1e-7)
    position[1, 1] = 0.05
    assert (0, 1, 2) in sorted_cells(triangulate(position, wall, 1.0))


@pytest.mark.parametrize("shift", [1e6, -1e6])
def test_a_lattice_far_from_the_origin_keeps_all_its_particles(shift):
    x = np.stack(np.meshgrid(np.arange(21.0), np.arange(21.0)), axis=-1).reshape(-1, 2)
    wall = ((x == 0) | (x == 20)).any(axis=1)
    here, there = triangulate(x, wall, 1.0), triangulate(x + shift, wall, 1.0)
    assert len(there.cells) == 800
    assert sorted_cells(here) == sorted_cells(there)
    assert (there.measure == 0.5).all()
    p = cloud(2, seed=5)
    far = triangulate(p.position + shift, p.wall, p.spacing)
    assert sorted_cells(far) == sorted_cells(mesh_of(p))
    np.testing.assert_allclose(np.sort(far.measure), np.sort(mesh_of(p).measure), rtol=1e-6)


def first(dimension: int, kind: str) -> tuple[tp.Particles, np.ndarray | None]:
    """Particles of a lattice, in 3-D on walls alone, and the edges that bound them where they are not convex."""
    water, size = tp.Fluid("water", 1000.0, 1e-3), (0.584, 0.3, 0.2)[:dimension]
    shape = tp.shapes.rectangle((0.0, 0.0), (0.6, 0.4), holes=[DISC]) if kind == "hole" else None
    tank = tp.tank(None if shape else size, 0.584 / 16, jitter=0.1 if dimension == 3 else 0.0, shape=shape)
    part = {"box": ((0,) * dimension, (0.146, *size[1:]))} if kind == "layer" else {"disc": ((0.1, 0.15), 0.08)}
    tank.fill(tp.Fluid("oil", 900.0, 1e-3)).fill(water, **part)
    case = tp.Case(tank, [region.fluid for region in tank.regions], (0.0,) * dimension)
    return case.particles, case.boundary.edges(case.particles, 0.0)


DISC = tp.shapes.circle((0.3, 0.2), 0.08)
KINDS = [(2, "layer"), (2, "drop"), (2, "hole"), (3, "layer")]


@pytest.mark.parametrize(("dimension", "kind"), KINDS)
def test_ties_do_not_depend_on_place_turn_and_mirror(dimension, kind):
    p, edges = first(dimension, kind)
    expected, rng = sorted_cells(triangulate(p.position, p.wall, p.spacing, edges)), np.random.default_rng(7)
    for angle, mirror in ((0.0, 1), (0.5 * np.pi, 1), (0.7, 1), (0.0, -1), (0.7, -1)):
        c, s = np.cos(angle), np.sin(angle)
        turn = np.eye(dimension)
        turn[:2, :2] = np.array([[c, -s], [s, c]]) @ np.diag([mirror, 1.0])
        there = p.position @ turn.T + rng.uniform(-100, 100, dimension)
        sides = edges if edges is None or mirror > 0 else edges[:, ::-1]
        assert sorted_cells(triangulate(there, p.wall, p.spacing, sides)) == expected


def test_diagonals_of_a_lattice_alternate():
    """All of them begin and end at particles of one colour of a chess board; those in corners go into them."""
    x = np.stack(np.meshgrid(np.arange(9.0), np.arange(13.0)), axis=-1).reshape(-1, 2)
    mesh = triangulate(x, ((x == 0) | (x == [8, 12])).any(axis=1), 1.0)
    diagonal = mesh.edges[(x[mesh.edges[:, 0]] != x[mesh.edges[:, 1]]).all(axis=1)]
    assert len(diagonal) == 8 * 12
    assert (x[diagonal].sum(axis=2) % 2 == 0).all()


@pytest.mark.parametrize("count", [188, 196, 226])
def test_walls_far_from_what_is_inside_keep_all_their_particles(count):
    """Three in a row and one far away are cocircular up to round-off; a flip there leaves a particle in no triangle."""
    along, zero = np.arange(count) / count, np.zeros(count)
    sides = [(along, zero), (zero + 1, along), (1 - along, zero + 1), (zero, 1 - along)]
    walls = np.concatenate([np.stack(side, axis=1) for side in sides])
    inner = np.stack(np.meshgrid(along[1 : count // 4], along[1 : count // 2], indexing="ij"), axis=-1).reshape(-1, 2)
    mesh = triangulate(np.concatenate([walls, inner]), np.arange(4 * count + len(inner)) < 4 * count, 1 / count)
    assert mesh.measure.sum() == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_the_unit_of_length_does_not_matter(scale):
    p = cloud(2, seed=6)
    mesh = triangulate(p.position * scale, p.wall, p.spacing * scale)
    assert sorted_cells(mesh) == sorted_cells(mesh_of(p))


def test_impossible_clouds_are_refused_with_the_particle():
    line = np.stack([np.arange(5.0), np.zeros(5)], axis=1)
    with pytest.raises(TriangulationError, match="cannot triangulate"):
        triangulate(line, np.ones(5, bool), 1.0)
    p = cloud(2)
    i = int(np.flatnonzero(~p.wall)[5])
    twice = np.concatenate([p.position, p.position[i : i + 1]])
    with pytest.raises(TriangulationError, match=rf"particle ({i}|{len(p)}) at \[.*in no simplex"):
        triangulate(twice, np.append(p.wall, False), p.spacing)


@pytest.mark.parametrize("dimension", [2, 3])
def test_edges_incidence_and_adjacency_are_those_of_the_cells(dimension):
    p = cloud(dimension, seed=7)
    mesh = mesh_of(p)
    edges, corners, neighbours = set(), [[] for _ in p.fluid], [{i} for i in range(len(p))]
    for m, cell in enumerate(mesh.cells.tolist()):
        edges |= set(itertools.combinations(sorted(cell), 2))
        for local, i in enumerate(cell):
            corners[i].append(m * (dimension + 1) + local)
            neighbours[i] |= set(cell)
    assert sorted(mesh.edges.tolist()) == sorted(map(list, edges))
    if dimension == 2:
        again = Mesh(mesh.position, mesh.cells)
        again.neighbours  # noqa: B018  (known, it finds the edges faster)
        assert sorted(again.edges.tolist()) == sorted(map(list, edges))
    assert mesh.used.tolist() == [bool(at) for at in corners]
    offsets, flat = mesh.incidence
    assert len(offsets) == len(p) + 1
    assert [flat[a:b].tolist() for a, b in itertools.pairwise(offsets)] == corners
    offsets, columns = adjacency(mesh)
    assert [columns[a:b].tolist() for a, b in itertools.pairwise(offsets)] == [sorted(s) for s in neighbours]
    assert len(columns) == offsets[-1]


def closest_connected(mesh: Mesh, fluid: np.ndarray, wall: np.ndarray) -> np.ndarray:
    """`wall_fluid` by brute force: round by round, from the particles that have a fluid at the round's start."""
    fluid, known = fluid.copy(), ~wall
    joined = {i: set() for i in range(len(fluid))}
    for cell in mesh.cells.tolist():
        for a, b in itertools.permutations(cell, 2):
            joined[a].add(b)
    while not known.all():
        found = {}
        for i in np.flatnonzero(~known):
            usable = [j for j in joined[i] if known[j]]
            if usable:
                found[i] = min(usable, key=lambda j: (np.linalg.norm(mesh.position[i] - mesh.position[j]), j))
        assert found
        labels = {i: fluid[j] for i, j in found.items()}
        for i, label in labels.items():
            fluid[i], known[i] = label, True
    return fluid


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("seed", [0, 1, 2, 3])
def test_walls_take_the_fluid_of_the_closest_connected_particle(dimension, seed):
    p = cloud(dimension, seed)
    labels = np.random.default_rng(seed).integers(0, 3, len(p)).astype(np.int32)
    mesh = mesh_of(p)
    expected = closest_connected(mesh, labels, p.wall)
    found = wall_fluid(mesh, labels, p.wall)
    np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal(found[~p.wall], labels[~p.wall])
    # What stood at the walls before does not matter, and the argument stays as it was.
    before = labels.copy()
    other = np.where(p.wall, 2 - labels, labels).astype(np.int32)
    np.testing.assert_array_equal(wall_fluid(mesh, other, p.wall), expected)
    np.testing.assert_array_equal(labels, before)


def test_a_corner_that_meets_walls_alone_takes_the_fluid_of_the_closer_one():
    # The corner 0 joins 1 and 2 alone; 1 is closer to it; each has a particle of its own fluid beside it.
    position = np.array([[0, 0], [0.9, 0], [0, 1.1], [1.2, 0.9], [0.9, 1.4], [3, 0], [3, 3], [0, 3]])
    wall = np.array([True, True, True, False, False, True, True, True])
    cells = np.array([[0, 1, 2], [1, 3, 2], [3, 4, 2], [1, 5, 3], [5, 6, 3], [3, 6, 4], [4, 6, 7], [2, 4, 7]], np.int32)
    mesh = Mesh(position, cells)
    assert (mesh.measure > 0).all()
    fluid = np.array([9, 9, 9, 5, 7, 9, 9, 9], np.int32)
    found = wall_fluid(mesh, fluid, wall)
    assert found.tolist() == [5, 5, 7, 5, 7, 5, 7, 7]


def test_a_moved_mesh_is_remembered_for_its_positions():
    mesh = mesh_of(cloud(2))
    moved = mesh.position + 1.0
    carried = mesh.moved(moved)
    assert mesh.moved(moved) is carried
    np.testing.assert_array_equal(carried.measure, mesh.moved(moved).measure)
    other = mesh.moved(2.0 * mesh.position)
    np.testing.assert_allclose(other.measure, 4.0 * mesh.measure, rtol=1e-10)
    assert mesh.moved(moved) is not carried


@pytest.mark.parametrize("seed", range(6))
def test_qhull_without_its_precautions_gives_the_same_triangles(seed, monkeypatch):
    """Where only wall particles are on circles: those of a lattice beside an irregular cloud, as in an empty tank."""
    p = cloud(2, seed)
    rng = np.random.default_rng(seed)
    inner = ~p.wall & ((p.position[:, 0] < 0.5) | (rng.uniform(size=len(p)) < 0.1))
    x, wall = p.position[inner | p.wall], p.wall[inner | p.wall]
    expected, asked = delaunay(x, p.spacing), []
    real = triangulation._oriented
    monkeypatch.setattr(triangulation, "_oriented", lambda *given: asked.append(given[2]) or real(*given))
    cells, measure, beyond = delaunay(x, p.spacing, wall)
    assert asked == [triangulation.QUICK]
    assert solid(cells, measure) == solid(*expected[:2])
    np.testing.assert_allclose(measure, simplex_measure(x, cells) / p.spacing**2, rtol=1e-10)
    assert measure.sum() == pytest.approx(expected[1].sum(), rel=1e-12)
    mesh = Mesh(x, cells)
    np.testing.assert_array_equal(beyond, mesh.neighbours)
    for turn in ([[0, -1], [1, 0]], [[-1, 0], [0, 1]]):
        assert solid(*delaunay(x @ np.array(turn) + rng.uniform(-100, 100, 2), p.spacing, wall)[:2]) == solid(
            cells, measure
        )


def solid(cells: np.ndarray, measure: np.ndarray) -> list[list[int]]:
    """The cells that are not flat, each sorted, in order."""
    return sorted(sorted(cell) for cell in cells[measure > triangulation.SLIVER].tolist())


def test_qhull_takes_its_precautions_where_particles_are_on_circles():
    p = cloud(2, jitter=0.0)
    expected, found = delaunay(p.position, p.spacing), delaunay(p.position, p.spacing, p.wall)
    for a, b in zip(expected, found, strict=True):
        np.testing.assert_array_equal(a, b)


def test_what_is_no_delaunay_triangulation_is_not_the_only_one():
    p = cloud(2)
    x = p.position / p.spacing
    cells, measure, beyond = triangulation._oriented(x, x, None)
    nobody = np.zeros(len(p), dtype=bool)
    right = triangulation._is_unique(x, cells, measure, beyond, p.wall)
    assert right == triangulation._is_unique(x, cells, measure, beyond, nobody)
    assert not triangulation._is_unique(x, cells[1:], measure[1:], beyond[1:], p.wall)
    inner = np.flatnonzero(~p.wall)[20]
    moved = x.copy()
    moved[inner] += [0.6, 0.3]  # into other triangles' circles
    assert not triangulation._is_unique(moved, cells, measure, beyond, p.wall)
    circle = np.stack([np.cos(np.arange(5.0)), np.sin(np.arange(5.0))], axis=1)
    for x, unique in ((circle[:4], True), (circle, False)):
        assert triangulation._is_unique(x, *triangulation._oriented(x, x, None), np.ones(len(x), bool)) == unique
