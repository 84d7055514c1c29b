"""tipfem/relocation.py: which particles move, where to, and that the cloud is sound and even afterwards."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

import tipfem as tp
from tipfem.mesh.delaunay import triangulate, wall_fluid
from tipfem.mesh.mesh import Mesh
from tipfem.remesh import relocation

RULE = tp.RelocationRule()
STATE = ("position", "velocity", "acceleration", "pressure")


def relocate(particles, mesh, rule):
    """The state, and how many particles were moved; what else it says of them must fit."""
    state, moves = relocation.relocate(particles, mesh, rule)
    moved = np.flatnonzero((state.position != particles.position).any(axis=1))
    np.testing.assert_array_equal(np.sort(moves[:, 0]), moved)
    if len(moves):  # on the way from one end to the other
        one, other = particles.position[moves[:, 1]], particles.position[moves[:, 2]]
        way, whole = state.position[moves[:, 0]] - one, other - one
        part = (way * whole).sum(axis=1) / (whole**2).sum(axis=1)
        np.testing.assert_allclose(way, part[:, None] * whole, atol=1e-12)
        assert set(part.round(9)) <= {0.5, round(1 / 3, 9)}
    return state, len(moves)


def meshed(p: tp.Particles) -> tuple[tp.Particles, Mesh]:
    """The particles with the walls' fluids, and their mesh."""
    mesh = triangulate(p.position, p.wall, p.spacing)
    return p.copy(fluid=wall_fluid(mesh, p.fluid, p.wall)), mesh


def with_state(p: tp.Particles, seed: int = 0) -> tp.Particles:
    """The particles with a random velocity, acceleration and pressure; walls at rest."""
    rng = np.random.default_rng(seed)
    v, a = rng.normal(size=p.position.shape), rng.normal(size=p.position.shape)
    v[p.wall] = a[p.wall] = 0
    return p.copy(velocity=v, acceleration=a, pressure=rng.normal(size=len(p)))


def lattice(jitter: float = 0.0, n: int = 10) -> tp.Particles:
    """A unit tank of spacing 1 / n, water under air."""
    water, air = tp.Fluid("water", 1000.0, 1e-3), tp.Fluid("air", 1.0, 1e-5)
    tank = tp.tank((1, 1), 1 / n, jitter=jitter).fill(air).fill(water, box=((0, 0), (1, 0.5)))
    return with_state(tank.sample([water, air]))


def crowded(seed: int, dimension: int = 2, n: int = 20) -> tp.Particles:
    """A tank of two fluids whose particles were drawn towards six random places."""
    rng = np.random.default_rng(seed)
    water, air = tp.Fluid("water", 1000.0, 1e-3), tp.Fluid("air", 1.0, 1e-5)
    tank = tp.tank((1,) * dimension, 1 / n, jitter=0.35, seed=seed).fill(air)
    p = tank.fill(water, box=((0,) * dimension, (1,) * (dimension - 1) + (0.5,))).sample([water, air])
    x, free = p.position.copy(), ~p.wall
    for _ in range(6):
        centre = rng.uniform(0.1, 0.9, dimension)
        pull = 0.8 * np.exp(-((np.linalg.norm(x - centre, axis=1) / 0.12) ** 2))
        x[free] += (centre - x[free]) * pull[free, None]
    return with_state(p.copy(position=x), seed)


def by_hand(position, fluid, wall, cells) -> tuple[tp.Particles, np.ndarray]:
    """Particles of spacing 1 and cells, turned to be positive."""
    p = with_state(tp.Particles(position, fluid, wall, spacing=1.0))
    cells = np.array(cells, np.int32)
    turned = Mesh(p.position, cells).measure < 0
    cells[turned, :2] = cells[turned, 1::-1]
    return p, cells


def at(p: tp.Particles, place) -> int:
    """The particle closest to a place."""
    return int(np.argmin(((p.position - place) ** 2).sum(axis=1)))


def pair(place, fluid: int, first: int) -> tuple[list, list, list]:
    """A crowded pair 0.3 apart with two neighbours, all of one fluid: positions, fluids, cell. Its edges are short."""
    x, y = place
    return [[x, y], [x + 0.3, y], [x + 0.1, y + 0.7]], [fluid] * 3, [first, first + 1, first + 2]


def moved_rows(p: tp.Particles, q: tp.Particles) -> np.ndarray:
    """Numbers of the particles that stand elsewhere."""
    return np.flatnonzero((p.position != q.position).any(axis=1))


def nearest(q: tp.Particles) -> np.ndarray:
    """(N,) distance to the nearest other particle, in spacings."""
    return cKDTree(q.position).query(q.position, k=2)[0][:, 1] / q.spacing


def why_crowded(p: tp.Particles, mesh: Mesh, i: int) -> float:
    """Smallest of a particle's edges, and 1.5 times its heights over wall facets, in spacings; by brute force."""
    smallest = np.inf
    for cell in mesh.cells[(mesh.cells == i).any(axis=1)]:
        others = cell[cell != i]
        smallest = min(smallest, np.linalg.norm(p.position[others] - p.position[i], axis=1).min())
        if p.wall[others].all():
            face = p.position[others]
            basis = np.linalg.qr((face[1:] - face[0]).T)[0]
            offset = p.position[i] - face[0]
            height = np.linalg.norm(offset - basis @ (basis.T @ offset))
            if height < RULE.too_close_to_wall * p.spacing:
                smallest = min(smallest, height * RULE.too_close / RULE.too_close_to_wall)
    return smallest / p.spacing


def landing(p: tp.Particles, mesh: Mesh, q: tp.Particles, i: int) -> tuple[int, int, float, float]:
    """The edge on which a moved particle stands: start, end, weight and length in spacings.

    The edge has an end of the particle's fluid, and the particle's whole state is that between the ends.
    """
    start, end = np.concatenate([mesh.edges, mesh.edges[:, ::-1]]).T
    own = p.fluid[start] == p.fluid[i]
    start, end = start[own], end[own]
    weight = np.where(p.fluid[end] == p.fluid[i], 0.5, 1 / 3)
    place = (1 - weight)[:, None] * p.position[start] + weight[:, None] * p.position[end]
    hit = np.flatnonzero(np.abs(place - q.position[i]).max(axis=1) < 1e-12 * max(1.0, np.abs(place).max()))
    assert len(hit), f"particle {i} stands on no edge of its fluid"
    for k in hit:
        same = [
            np.allclose(getattr(q, name)[i], (1 - weight[k]) * old[start[k]] + weight[k] * old[end[k]], rtol=1e-12)
            for name in STATE
            for old in [getattr(p, name)]
        ]
        if all(same):
            length = np.linalg.norm(p.position[start[k]] - p.position[end[k]]) / p.spacing
            return int(start[k]), int(end[k]), float(weight[k]), float(length)
    raise AssertionError(f"the state of particle {i} is not that between the ends of its edge")


def check(p: tp.Particles, mesh: Mesh, q: tp.Particles, count: int) -> np.ndarray:
    """All that must hold of any relocation; returns the numbers of the moved particles."""
    moved = moved_rows(p, q)
    assert len(moved) == count
    still = np.setdiff1d(np.arange(len(p)), moved)
    for name in STATE:
        np.testing.assert_array_equal(getattr(q, name)[still], getattr(p, name)[still])
    for name in ("fluid", "wall"):
        np.testing.assert_array_equal(getattr(q, name), getattr(p, name))
    assert q.spacing == p.spacing
    assert not p.wall[moved].any()
    taken: dict[int, set[tuple[int, int]]] = {}
    for i in moved:
        crowd = why_crowded(p, mesh, i)
        assert crowd < RULE.too_close
        start, end, weight, length = landing(p, mesh, q, i)
        assert {start, end}.isdisjoint(moved)
        assert not (p.wall[start] and p.wall[end])
        if weight == 0.5:
            assert length > RULE.long_edge or (length > 1 and crowd < RULE.urgent)
        else:
            assert length > RULE.long_mixed_edge
        edges = taken.setdefault(int(p.fluid[i]), set())
        edge = (min(start, end), max(start, end))
        assert edge not in edges, "two particles of a fluid landed on one edge"
        edges.add(edge)
    assert (q.position >= p.position.min(axis=0)).all()
    assert (q.position <= p.position.max(axis=0)).all()
    return moved


def test_nothing_moves_on_a_fresh_lattice():
    for p in (lattice(), lattice(jitter=0.15), crowded(0).copy(position=lattice(n=20).position)):
        p, mesh = meshed(p)
        q, count = relocate(p, mesh, RULE)
        assert count == 0
        assert q is p


@pytest.mark.parametrize("distance", [0.59, 0.3, 0.05, 0.61])
def test_one_of_a_close_pair_moves_into_the_hole(distance):
    p = lattice()
    one = at(p, [0.3, 0.2])
    other = at(p, [0.7, 0.3])
    hole = p.position[other].copy()
    p.position[other] = p.position[one] + distance * p.spacing * np.array([0.6, 0.8])
    before = p.copy()
    q, mesh = meshed(p)
    q, count = relocate(p, mesh, RULE)
    for name in STATE:
        np.testing.assert_array_equal(getattr(p, name), getattr(before, name))
    if distance > 0.6:
        assert count == 0
        return
    moved = check(p, mesh, q, count)
    assert moved.tolist() == [max(one, other)]
    assert np.linalg.norm(q.position[moved[0]] - hole) < 0.6 * p.spacing
    assert nearest(q)[moved[0]] >= 0.6


@pytest.mark.parametrize("height", [0.39, 0.41])
def test_a_particle_low_over_a_wall_moves(height):
    p = lattice()
    low = at(p, [0.5, 0.1])
    # Far from its neighbours, between two particles of the wall: only the height can be too small.
    p.position[low] = (0.55, height * p.spacing)
    p.position[at(p, [0.6, 0.1])] += (0.02, 0.02)
    p, mesh = meshed(p)
    edges = mesh.edges[(mesh.edges == low).any(axis=1)]
    assert np.linalg.norm(p.position[edges[:, 0]] - p.position[edges[:, 1]], axis=1).min() > 0.6 * p.spacing
    q, count = relocate(p, mesh, RULE)
    assert check(p, mesh, q, count).tolist() == ([low] if height < 0.4 else [])


def test_an_urgent_particle_takes_an_edge_of_more_than_one_spacing():
    # One edge of 1.15 between a and b; the pair is 0.5 or 0.3 apart.
    for distance, count in ((0.5, 0), (0.3, 1)):
        x = [[0, 0], [1.15, 0], [0.575, 0.75], [9, 9], [9 + distance, 9], [9.1, 9.8]]
        p, cells = by_hand(x, [0] * 6, [False] * 6, [[0, 1, 2], [3, 4, 5]])
        q, moved = relocate(p, Mesh(p.position, cells), RULE)
        assert moved == count
        if count:
            assert check(p, Mesh(p.position, cells), q, moved).tolist() == [4]
            np.testing.assert_allclose(q.position[4], [0.575, 0])


@pytest.mark.parametrize("fluid", [0, 1])
@pytest.mark.parametrize("length", [1.7, 1.9, 2.5])
def test_a_long_mixed_edge_is_filled_at_a_third_on_the_own_side(fluid, length):
    # Corners 0 and 2 are of the pair's fluid, 1.14 apart; two mixed edges run to corner 1.
    more, labels, cell = pair((9, 9), fluid, 3)
    x = [[0, 0], [length, 0], [0.3, 1.1], *more]
    p, cells = by_hand(x, [fluid, 1 - fluid, fluid, *labels], [False] * 6, [[0, 1, 2], cell])
    mesh = Mesh(p.position, cells)
    q, count = relocate(p, Mesh(p.position, cells), RULE)
    assert check(p, mesh, q, count).tolist() == [4]
    other = np.hypot(length - 0.3, 1.1)
    expected = (0, 1, 1 / 3, length) if length > other else (2, 1, 1 / 3, other)
    if max(length, other) < RULE.long_mixed_edge:  # only the short edge is left, and the pair is urgent
        expected = (0, 2, 0.5, np.hypot(0.3, 1.1))
    start, end, weight, found = landing(p, mesh, q, 4)
    assert (start, end, weight) == expected[:3]
    assert found == pytest.approx(expected[3])


def test_particles_go_to_edges_of_their_own_fluid_alone():
    # Fluid 1 has long edges, fluid 0 has the pair: nothing moves; with the labels exchanged it does.
    more, labels, cell = pair((9, 9), 0, 3)
    x = [[0, 0], [1.5, 0], [0.75, 1.4], *more]
    p, cells = by_hand(x, [1, 1, 1, *labels], [False] * 6, [[0, 1, 2], cell])
    assert relocate(p, Mesh(p.position, cells), RULE)[1] == 0
    p.fluid[:3] = 0
    q, count = relocate(p, Mesh(p.position, cells), RULE)
    moved = check(p, Mesh(p.position, cells), q, count)
    assert moved.tolist() == [4]
    assert landing(p, Mesh(p.position, cells), q, 4)[3] == pytest.approx(np.hypot(0.75, 1.4))


def test_the_longest_edges_are_filled_first_and_the_most_crowded_move_first():
    x, labels, cells = [], [], []
    for k, length in enumerate((1.3, 1.7, 1.5)):
        cells.append([len(x), len(x) + 1, len(x) + 2])
        x += [[10 * k, 0], [10 * k + length, 0], [10 * k + length / 2, 0.7]]
    for k, distance in enumerate((0.5, 0.4)):
        cells.append([len(x), len(x) + 1, len(x) + 2])
        x += [[10 * k, 9], [10 * k + distance, 9], [10 * k + 0.2, 9.7]]
    labels = [0] * len(x)
    p, cells = by_hand(x, labels, [False] * len(x), cells)
    q, count = relocate(p, Mesh(p.position, cells), RULE)
    assert check(p, Mesh(p.position, cells), q, count).tolist() == [10, 13]
    np.testing.assert_allclose(q.position[13], [10.85, 0])
    np.testing.assert_allclose(q.position[10], [20.75, 0])


def test_edges_of_the_wall_take_nothing():
    more, labels, cell = pair((9, 9), 0, 3)
    x = [[0, 0], [2.0, 0], [1.0, 0.9], *more]
    p, cells = by_hand(x, [0, 0, 0, *labels], [True, True, False, False, False, False], [[0, 1, 2], cell])
    q, count = relocate(p, Mesh(p.position, cells), RULE)
    if count:
        assert landing(p, Mesh(p.position, cells), q, 4)[:2] != (0, 1)
        assert q.position[4, 1] >= RULE.too_close_to_wall


@pytest.mark.parametrize("seed", range(12))
def test_random_crowds_stay_sound_and_become_even(seed):
    p = crowded(seed)
    number = np.bincount(p.fluid[~p.wall])
    walls = p.position[p.wall].copy()
    counts = []
    for _ in range(20):
        p, mesh = meshed(p)
        assert (mesh.measure > 0).all()
        assert mesh.measure.sum() == pytest.approx(1.0, rel=1e-9)
        q, count = relocate(p, mesh, RULE)
        check(p, mesh, q, count)
        q.require_distinct()
        assert nearest(q)[moved_rows(p, q)].min(initial=1.0) > 0.4
        assert (q.position[~q.wall] > 0).all()
        assert (q.position[~q.wall] < 1).all()
        counts.append(count)
        p = q
        if not count:
            break
    assert counts[0] > 30
    assert counts[-1] == 0
    np.testing.assert_array_equal(np.bincount(p.fluid[~p.wall]), number)
    np.testing.assert_array_equal(p.position[p.wall], walls)
    assert nearest(p).min() >= 0.6
    longest = np.linalg.norm(p.position[mesh.edges[:, 0]] - p.position[mesh.edges[:, 1]], axis=1).max()
    assert longest < 4 * p.spacing


def test_relocation_depends_on_the_particles_alone():
    p, mesh = meshed(crowded(3))
    one, other = relocate(p, mesh, RULE)[0], relocate(p.copy(), Mesh(p.position.copy(), mesh.cells.copy()), RULE)[0]
    np.testing.assert_array_equal(one.position, other.position)
    # In another unit of length the same particles move to the same places.
    far = relocate(p.copy(position=8 * p.position, spacing=8 * p.spacing), mesh, RULE)[0]
    np.testing.assert_allclose(far.position, 8 * one.position, rtol=1e-12)


def test_in_three_dimensions_the_first_relocations_are_sound():
    p = crowded(1, dimension=3, n=8)
    walls = p.position[p.wall].copy()
    counts = []
    for _ in range(3):
        p, mesh = meshed(p)
        q, count = relocate(p, mesh, RULE)
        check(p, mesh, q, count)
        counts.append(count)
        p = q
    np.testing.assert_array_equal(p.position[p.wall], walls)
    assert counts[0] > counts[-1] >= 0


@pytest.mark.parametrize("seed", [0, 11, 56, 71, 97, 170, 178])
def test_no_moved_particle_is_crowded_where_it_lands(seed):
    p = crowded(seed)
    for _ in range(10):
        p, mesh = meshed(p)
        q, count = relocate(p, mesh, RULE)
        assert nearest(q)[moved_rows(p, q)].min(initial=1.0) >= RULE.too_close
        p = q
        if not count:
            break


def test_a_third_of_a_mixed_edge_beside_another_particle_is_not_free():
    more, labels, cell = pair((9, 9), 0, 3)
    x = [[0, 0], [3, 0], [1, 0.45], *more]
    p, cells = by_hand(x, [0, 1, 1, *labels], [False] * 6, [[0, 1, 2], cell])
    q, _ = relocate(p, Mesh(p.position, cells), RULE)
    assert nearest(q)[moved_rows(p, q)].min(initial=1.0) >= RULE.too_close


def test_a_third_of_a_mixed_edge_low_over_the_wall_is_not_free():
    more, labels, cell = pair((9, 9), 0, 3)
    x = [[0, 0], [-1, 0], [1.6, 1.0], *more]
    p, cells = by_hand(x, [0, 0, 1, *labels], [True, True, False] + [False] * 3, [[0, 1, 2], cell])
    q, _ = relocate(p, Mesh(p.position, cells), RULE)
    assert (q.position[moved_rows(p, q), 1] >= RULE.too_close_to_wall).all()


def test_crossing_edges_in_three_dimensions_do_not_both_take_a_particle():
    x = [[0, 0, 0], [1, 0, 0.05], [1, 1, 0], [0, 1, 0.05]]
    cells = [[0, 1, 2, 3]]
    for k in range(2):
        cells.append([len(x) + a for a in range(4)])
        x += (np.array([[0, 0, 0], [0.3, 0, 0], [0.1, 0.7, 0], [0.1, 0, 0.7]]) + [9, 9 * k, 9]).tolist()
    p, cells = by_hand(x, [0] * 12, [False] * 12, cells)
    q, count = relocate(p, Mesh(p.position, cells), RULE)
    assert count >= 1
    assert nearest(q)[moved_rows(p, q)].min() >= RULE.too_close


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_in_three_dimensions_relocation_comes_to_rest(seed):
    p = crowded(seed, dimension=3, n=8)
    for _ in range(12):
        p, mesh = meshed(p)
        p, count = relocate(p, mesh, RULE)
        if not count:
            break
    assert count == 0


def test_of_a_close_pair_of_two_fluids_the_one_that_can_moves():
    x = [[0, 0], [1.5, 0], [0.75, 0.9], [9, 9], [9.3, 9], [9.1, 9.7]]
    p, cells = by_hand(x, [0, 0, 0, 0, 1, 1], [False] * 6, [[0, 1, 2], [3, 4, 5]])
    q, count = relocate(p, Mesh(p.position, cells), RULE)
    assert count == 1
    assert moved_rows(p, q).tolist() == [3]


def test_two_fluids_on_one_mixed_edge_keep_their_distance():
    water, water_labels, water_cell = pair((9, 9), 0, 3)
    air, air_labels, air_cell = pair((19, 9), 1, 6)
    x = [[0, 0], [1.85, 0], [0.3, 0.8], *water, *air]
    p, cells = by_hand(x, [0, 1, 0, *water_labels, *air_labels], [False] * 9, [[0, 1, 2], water_cell, air_cell])
    q, count = relocate(p, Mesh(p.position, cells), RULE)
    assert len(check(p, Mesh(p.position, cells), q, count)) >= 1
    assert nearest(q)[moved_rows(p, q)].min() >= RULE.too_close


@pytest.mark.parametrize("name", ["too_close", "too_close_to_wall", "long_edge", "long_mixed_edge", "urgent"])
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan")])
def test_lengths_of_the_rule_must_be_positive(name, value):
    with pytest.raises(ValueError, match=f"RelocationRule: {name} is {value!r} spacings; it must be a number > 0"):
        tp.RelocationRule(**{name: value})


def test_a_rule_that_would_undo_itself_is_refused():
    with pytest.raises(ValueError, match=r"long_edge is 1\.1, below twice too_close 0\.6"):
        tp.RelocationRule(long_edge=1.1)
    with pytest.raises(ValueError, match=r"long_edge is 1\.2, below twice too_close 0\.7"):
        tp.RelocationRule(too_close=0.7)
    assert tp.RelocationRule(too_close=0.5, long_edge=1.0).long_edge == 1.0


def test_a_rule_that_would_undo_itself_at_mixed_edges_is_refused():
    with pytest.raises(ValueError, match="long_mixed_edge"):
        tp.RelocationRule(long_mixed_edge=1.2)


def test_the_rule_decides():
    p, mesh = meshed(crowded(5))
    counts = [
        relocate(p, mesh, rule)[1]
        for rule in (tp.RelocationRule(too_close=0.01, too_close_to_wall=0.01), tp.RelocationRule(too_close=0.4), RULE)
    ]
    assert counts[0] <= counts[1] < counts[2]
