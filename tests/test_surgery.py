"""tipfem/surgery.py and the flips of remeshing_kernels.py: against Qhull, brute force and exact arithmetic."""

from fractions import Fraction

import numpy as np
import pytest
import taichi as ti
from scipy.spatial import Delaunay

from tipfem import surgery
from tipfem.fitted import Triangulation
from tipfem.mesh import Mesh, simplex_measure

CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


@ti.kernel
def in_circles(x: ti.types.ndarray(), four: ti.types.ndarray(), result: ti.types.ndarray()):
    for k in range(four.shape[0]):
        result[k] = surgery.in_circle(x, four[k, 0], four[k, 1], four[k, 2], four[k, 3])


@ti.kernel
def flip_edges(
    x: ti.types.ndarray(), cells: ti.types.ndarray(), across: ti.types.ndarray(), fluid: ti.types.ndarray(),
    corner: ti.types.ndarray(), edges: ti.types.ndarray(), flat: ti.f64, count: ti.types.ndarray(),
):  # fmt: skip
    """Flip those of ``edges`` (3 * cell + corner) that lie in one fluid and in a convex quadrilateral."""
    ti.loop_config(serialize=True)
    for k in range(edges.shape[0]):
        t, i = edges[k] // 3, edges[k] % 3
        o = across[t, i]
        if o >= 0:
            a, b, c = cells[t, i], cells[t, (i + 1) % 3], cells[t, (i + 2) % 3]
            d = cells[o, surgery.place(across, o, t)]
            convex = surgery.double_area(x, a, b, d) > flat and surgery.double_area(x, a, d, c) > flat
            if fluid[o] == fluid[t] and convex:
                surgery.flip(cells, across, corner, t, i)
                count[0] += 1


@ti.kernel
def split_edge(
    cells: ti.types.ndarray(), across: ti.types.ndarray(), corner: ti.types.ndarray(), fluid: ti.types.ndarray(),
    t: ti.i32, i: ti.i32, n: ti.i32, t2: ti.i32, o2: ti.i32,
):  # fmt: skip
    ti.loop_config(serialize=True)
    for _ in range(1):
        surgery.split(cells, across, corner, fluid, t, i, n, t2, o2)


@ti.kernel
def star_of(
    cells: ti.types.ndarray(), across: ti.types.ndarray(), corner: ti.types.ndarray(), p: ti.i32,
    star: ti.types.ndarray(), result: ti.types.ndarray(),
):  # fmt: skip
    ti.loop_config(serialize=True)
    for _ in range(1):
        count, closed = surgery.collect_star(cells, across, corner, p, star, 0)
        result[0], result[1] = count, closed


@ti.kernel
def collapse_edge(
    x: ti.types.ndarray(), cells: ti.types.ndarray(), across: ti.types.ndarray(), corner: ti.types.ndarray(),
    fluid: ti.types.ndarray(), star: ti.types.ndarray(), p: ti.i32, q: ti.i32, least: ti.f64,
    done: ti.types.ndarray(),
):  # fmt: skip
    ti.loop_config(serialize=True)
    for _ in range(1):
        count, _closed = surgery.collect_star(cells, across, corner, p, star, 0)
        if surgery.can_collapse(x, cells, star, 0, count, p, q, least):
            surgery.collapse(cells, across, corner, fluid, star, 0, count, p, q)
            done[0] = 1


def of(position, cells, fluid=None) -> Triangulation:
    """A triangulation of one fluid, or of those given."""
    cells = np.ascontiguousarray(cells, dtype=np.int32)
    mesh = Mesh(position, cells)
    state = np.zeros((len(position), 7))
    state[:, :2] = position
    corner = np.full(len(position), -1, dtype=np.int32)
    corner[cells.ravel()] = np.arange(cells.size, dtype=np.int32) // 3
    fluid = np.zeros(len(cells)) if fluid is None else fluid
    return Triangulation(state, cells.copy(), mesh.across.copy(), np.array(fluid, dtype=np.int32), corner)


def delaunay(x) -> np.ndarray:
    """Qhull's triangles, counter-clockwise, without those that have no area; points 0 to 3 span the hull."""
    cells = Delaunay(x).simplices.astype(np.int32)
    measure = simplex_measure(x, cells)
    cells[measure < 0] = cells[measure < 0][:, ::-1]
    return cells[np.abs(measure) > 1e-14]


def check(t: Triangulation, gone: int = 0) -> None:
    """All that must hold of a triangulation whose ``gone`` particles have no cells."""
    alive = t.fluid >= 0
    cells = t.cells[alive]
    number = np.where(alive, np.cumsum(alive) - 1, -1)
    x = np.ascontiguousarray(t.state[:, :2])
    np.testing.assert_array_equal(
        np.where(t.across[alive] >= 0, number[t.across[alive]], -1), Mesh(x, cells).across, "neighbours"
    )
    assert (simplex_measure(x, cells) > 0).all()
    used = np.unique(cells)
    np.testing.assert_array_equal(np.flatnonzero(t.corner >= 0), used)
    assert (t.cells[t.corner[used]] == used[:, None]).any(axis=1).all()
    assert alive[t.corner[used]].all()
    assert len(used) == len(x) - gone
    hull = int((t.across[alive] < 0).sum())
    assert len(cells) == 2 * len(used) - 2 - hull  # Euler, of a disc


def as_set(cells) -> set[tuple[int, ...]]:
    """Cells without their order."""
    return set(map(tuple, np.sort(cells, axis=1).tolist()))


def border(t: Triangulation, hull: bool = False) -> np.ndarray:
    """The edges (K, 2) between two fluids, or those of the hull."""
    cell, i = np.nonzero(t.across < 0 if hull else (t.across >= 0) & (t.fluid[t.across] != t.fluid[:, None]))
    return np.stack([t.cells[cell, (i + 1) % 3], t.cells[cell, (i + 2) % 3]], axis=1)


def inner_edges(t: Triangulation):
    """The four particles (K, 4) around each inner edge of one fluid: those of a cell, and the one beyond."""
    cell, i = np.nonzero((t.across > np.arange(len(t.cells))[:, None]) & (t.fluid[t.across] == t.fluid[:, None]))
    o = t.across[cell, i]
    j = np.argmax(t.across[o] == cell[:, None], axis=1)
    four = np.stack([t.cells[cell, i], t.cells[cell, (i + 1) % 3], t.cells[cell, (i + 2) % 3], t.cells[o, j]], axis=1)
    return four.astype(np.int32)


def circle_test(x, four) -> np.ndarray:
    """`surgery.in_circle` in NumPy, by a general determinant."""
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


KINDS = ["random", "clustered", "circles", "lattice", "jittered lattice", "walls", "thin", "stretched"]


def shuffled(t: Triangulation, seed: int) -> int:
    """Flip edges at random; how many."""
    count = np.zeros(1, dtype=np.int32)
    edges = np.random.default_rng(seed).permutation(np.tile(np.arange(t.cells.size, dtype=np.int32), 3))
    flat = 1e-10 * float(np.ptp(t.state[:, 1]))
    flip_edges(t.state, t.cells, t.across, t.fluid, t.corner, edges, flat, count)
    return int(count[0])


@pytest.mark.parametrize("kind", KINDS)
def test_flips_make_the_triangulation_of_qhull(kind):
    """From any triangulation of the points: every edge is Delaunay, and the set the same without ties."""
    same = 0
    for seed in range(150):
        x = cloud(kind, seed)
        start = delaunay(x)
        t = of(x, start)
        assert shuffled(t, seed) > 0
        check(t)
        hull = as_set(border(t, hull=True))
        t.make_delaunay(1e-13)
        check(t)
        assert as_set(border(t, hull=True)) == hull
        assert simplex_measure(x, t.cells).sum() == pytest.approx(np.ptp(x[:, 0]) * np.ptp(x[:, 1]), rel=1e-12)
        assert circle_test(x, inner_edges(t)).max(initial=-1.0) < 1e-12
        if np.abs(circle_test(x, inner_edges(of(x, start)))).min(initial=1.0) > 1e-11:
            same += 1
            assert as_set(t.cells) == as_set(start)
    assert same > 100 or kind in ("circles", "lattice")


def test_flips_follow_points_that_wander():
    """Jittered lattices that walk in small steps: repaired after every step, the mesh is that of Qhull."""
    for seed in range(4):
        rng = np.random.default_rng(seed)
        x = cloud("jittered lattice", seed)
        t = of(x, delaunay(x))
        flips = 0
        for _ in range(100):
            step = np.zeros_like(x)
            step[4:] = rng.normal(size=(len(x) - 4, 2)) * 0.004
            while (simplex_measure(x + step, t.cells) <= 0).any() or (np.abs(x + step - 0.5) > 0.5).any():
                step *= 0.5
            x = x + step
            t.state[:, :2] = x
            flips += t.make_delaunay(1e-13)
            check(t)
            assert as_set(t.cells) == as_set(delaunay(x))
        assert flips > 100


def test_a_slack_leaves_what_is_delaunay_but_for_it():
    x = cloud("lattice", 0)
    x[4:] += np.random.default_rng(0).uniform(-1e-5, 1e-5, x[4:].shape)
    t = of(x, delaunay(x))
    assert shuffled(t, 1) > 0
    t.make_delaunay(1e-3)
    assert t.make_delaunay(1e-3) == 0
    assert 1e-9 < circle_test(x, inner_edges(t)).max() <= 1e-3  # ties are left as they were
    assert as_set(t.cells) != as_set(delaunay(x))


def test_interfaces_are_never_flipped():
    """Constrained Delaunay is unique: whatever the start, the interface stays and the rest is the same."""
    for seed in range(100):
        x = cloud("random" if seed % 2 else "jittered lattice", seed)
        cells = delaunay(x)
        fluid = np.random.default_rng(seed).integers(0, 3, len(cells))
        fluid[x[cells].mean(axis=1)[:, 0] > 0.6] = 2
        t = of(x, cells, fluid)
        area = np.bincount(fluid, weights=simplex_measure(x, cells), minlength=3)
        interface = as_set(border(t))
        results = []
        for k in range(2):
            shuffled(t, 10 * seed + k)
            t.make_delaunay(1e-13)
            check(t)
            results.append({(*cell, f) for cell, f in zip(map(tuple, np.sort(t.cells, axis=1)), t.fluid, strict=True)})
            assert as_set(border(t)) == interface
            assert circle_test(x, inner_edges(t)).max(initial=-1.0) < 1e-12
            has = np.bincount(t.fluid, weights=simplex_measure(x, t.cells), minlength=3)
            np.testing.assert_allclose(has, area, rtol=1e-13)
        assert results[0] == results[1]


def test_in_circle_is_the_determinant_with_the_right_sign():
    rng = np.random.default_rng(3)
    x = np.round(rng.uniform(-1, 1, (200, 2)), 3)
    x = np.concatenate([x, 1e-5 * x, [1e3, -1e3] + x])
    four = np.array([rng.choice(200, 4, replace=False) for _ in range(400)], dtype=np.int32)
    four = np.concatenate([four, four + 200, four + 400])
    clockwise = simplex_measure(x, four[:, :3]) < 0
    four[clockwise] = four[clockwise][:, [1, 0, 2, 3]]
    result = np.empty(len(four))
    in_circles(x, four, result)
    np.testing.assert_allclose(result, circle_test(x, four), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(result[:400], result[400:800], rtol=1e-9, atol=1e-15)  # no matter the unit
    for (a, b, c, d), value in zip(four[:400], result, strict=False):
        p = [[Fraction(float(s)) for s in x[k] - x[d]] for k in (a, b, c)]
        s = [u * u + v * v for u, v in p]
        exact = sum(s[k] * (p[k - 2][0] * p[k - 1][1] - p[k - 1][0] * p[k - 2][1]) for k in range(3))
        assert abs(value) < 1e-14 or (value > 0) == (exact > 0)


@pytest.mark.parametrize("seed", range(3))
def test_a_split_edge_has_its_particle_and_the_areas_are_kept(seed):
    x = cloud("walls", seed)
    first = of(x, delaunay(x))
    fluid = np.arange(len(first.cells)) % 3
    for t0 in range(len(first.cells)):
        for i in range(3):
            t = of(x, first.cells, fluid)
            b, c = t.cells[t0, (i + 1) % 3], t.cells[t0, (i + 2) % 3]
            hull = t.across[t0, i] < 0
            t = of(np.concatenate([x, [0.5 * (x[b] + x[c])]]), t.cells, fluid)
            more = len(t.cells)
            t.cells = np.concatenate([t.cells, np.zeros((2, 3), dtype=np.int32)])
            t.across = np.concatenate([t.across, np.full((2, 3), -1, dtype=np.int32)])
            t.fluid = np.concatenate([t.fluid, np.full(2, -1, dtype=np.int32)])
            split_edge(t.cells, t.across, t.corner, t.fluid, t0, i, len(x), more + 1, more)
            assert (t.fluid[more:] >= 0).tolist() == [not hull, True]
            t.compact()
            check(t)
            assert ((t.cells == len(x)).any(axis=1)).sum() == (2 if hull else 4)
            assert not ((t.cells == b).any(axis=1) & (t.cells == c).any(axis=1)).any()
            np.testing.assert_allclose(
                np.bincount(t.fluid, weights=simplex_measure(t.state[:, :2], t.cells)),
                np.bincount(fluid, weights=simplex_measure(x, first.cells)), rtol=1e-12,
            )  # fmt: skip


def test_a_star_goes_round_its_particle():
    for seed in range(10):
        x = cloud("walls", seed)
        t = of(x, delaunay(x))
        on_hull = np.unique(border(t, hull=True))
        for p in range(len(x)):
            star, result = np.empty(surgery.STAR + 1, dtype=np.int32), np.zeros(2, dtype=np.int32)
            star_of(t.cells, t.across, t.corner, p, star, result)
            around = star[: result[0]]
            assert sorted(around) == np.flatnonzero((t.cells == p).any(axis=1)).tolist()
            assert result[1] == (p not in on_hull)
            place = np.argmax(t.cells[around] == p, axis=1)
            starts, ends = t.cells[around, (place + 1) % 3], t.cells[around, (place + 2) % 3]
            assert starts[1:].tolist() == ends[:-1].tolist()
            assert (starts[0] == ends[-1]) == result[1]


def test_a_star_of_too_many_cells_is_left_alone():
    for n, expected in ((surgery.STAR, surgery.STAR), (surgery.STAR + 1, 0)):
        angle = 2 * np.pi * np.arange(n) / n
        x = np.concatenate([np.stack([np.cos(angle), np.sin(angle)], axis=1), [[0.0, 0.0]]])
        t = of(x, np.stack([np.arange(n), (np.arange(n) + 1) % n, np.full(n, n)], axis=1))
        star, result = np.full(surgery.STAR + 4, -7, dtype=np.int32), np.zeros(2, dtype=np.int32)
        star_of(t.cells, t.across, t.corner, n, star, result)
        assert result[0] == expected
        assert (star[surgery.STAR + 1 :] == -7).all()


@pytest.mark.parametrize("kind", ["random", "walls"])
def test_a_collapsed_edge_takes_two_cells_along_and_the_rest_keeps_its_area(kind):
    """Against brute force, for every edge that may go: the cells are those with p replaced by q."""
    done = np.zeros(1, dtype=np.int32)
    tried = went = 0
    for seed in range(6):
        x = cloud(kind, seed)
        first = of(x, delaunay(x))
        wall = ((x == 0) | (x == 1)).any(axis=1)
        for p in range(4, len(x)):
            for q in np.setdiff1d(first.cells[(first.cells == p).any(axis=1)], [p]):
                if wall[p] and not (x[p] == x[q])[(x[p] == 0) | (x[p] == 1)].all():
                    continue  # a wall particle goes along its wall only
                t = of(x, first.cells)
                done[0] = 0
                star = np.empty(surgery.STAR + 1, dtype=np.int32)
                collapse_edge(t.state, t.cells, t.across, t.corner, t.fluid, star, int(p), int(q), 1e-9, done)
                kept = np.where(first.cells == p, q, first.cells)
                kept = kept[~((first.cells == p).any(axis=1) & (first.cells == q).any(axis=1))]
                assert done[0] == (2 * simplex_measure(x, kept)[(kept == q).any(axis=1)] >= 1e-9).all()
                tried += 1
                if done[0]:
                    went += 1
                    t.compact()
                    check(t, gone=1)
                    assert t.corner[p] == -1
                    assert as_set(t.cells) == as_set(kept)
                    assert simplex_measure(x, t.cells).sum() == pytest.approx(1.0, rel=1e-12)
    assert 0.2 * tried < went < tried
