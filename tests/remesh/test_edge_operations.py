"""Edge operations against brute force and exact arithmetic."""

from fractions import Fraction

import numpy as np
import pytest
import taichi as ti
from triangulations import as_set, border, check, circle_test, cloud, delaunay, of

from tipfem.backend.array_types import Ints1, Ints2, Periods, Reals1, Reals2
from tipfem.backend.launch import kernel, launch
from tipfem.geometry.period import no_period
from tipfem.mesh.mesh import simplex_measure
from tipfem.remesh.triangles import edge_operations
from tipfem.remesh.triangles.edge_operations import Segment, TriangleArrays


@kernel
def circle_determinants(x: Reals2, period: Periods, four: Ints2, result: Reals1):
    mesh = ti.static(TriangleArrays(x, None, None, None, period))
    for k in range(four.shape[0]):
        inside, a, b, c = edge_operations.circle_determinant(mesh, four[k, 0], four[k, 1], four[k, 2], four[k, 3])
        result[k] = inside / ti.max(a, b, c) ** 2


@kernel
def split_edge(
    cells: Ints2,
    neighbours: Ints2,
    corner: Ints1,
    fluid: Ints1,
    t: ti.i32,
    i: ti.i32,
    n: ti.i32,
    t2: ti.i32,
    o2: ti.i32,
):
    mesh = ti.static(TriangleArrays(None, cells, neighbours, fluid, None, corner))
    ti.loop_config(serialize=True)
    for _ in range(1):
        edge_operations.split(mesh, t, i, n, t2, o2)


@kernel
def star_of(
    cells: Ints2,
    neighbours: Ints2,
    corner: Ints1,
    p: ti.i32,
    star: Ints1,
    result: Ints1,
):
    mesh, around = ti.static(TriangleArrays(None, cells, neighbours, None, None, corner), Segment(star))
    ti.loop_config(serialize=True)
    for _ in range(1):
        count, closed = edge_operations.collect_star(mesh, around, p)
        result[0], result[1] = count, closed


@kernel
def collapse_edge(
    x: Reals2,
    cells: Ints2,
    neighbours: Ints2,
    corner: Ints1,
    fluid: Ints1,
    period: Periods,
    star: Ints1,
    p: ti.i32,
    q: ti.i32,
    least: ti.f64,
    done: Ints1,
):
    mesh, around = ti.static(TriangleArrays(x, cells, neighbours, fluid, period, corner), Segment(star))
    ti.loop_config(serialize=True)
    for _ in range(1):
        count, _closed = edge_operations.collect_star(mesh, around, p)
        if edge_operations.can_collapse(mesh, around, count, p, q, least):
            edge_operations.collapse(mesh, around, count, p, q)
            done[0] = 1


def test_the_circle_determinant_has_the_right_sign():
    rng = np.random.default_rng(3)
    x = np.round(rng.uniform(-1, 1, (200, 2)), 3)
    x = np.concatenate([x, 1e-5 * x, [1e3, -1e3] + x])
    four = np.array([rng.choice(200, 4, replace=False) for _ in range(400)], dtype=np.int32)
    four = np.concatenate([four, four + 200, four + 400])
    clockwise = simplex_measure(x, four[:, :3]) < 0
    four[clockwise] = four[clockwise][:, [1, 0, 2, 3]]
    result = np.empty(len(four))
    launch(circle_determinants, x, no_period(2).array, four, result)
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
            hull = t.neighbours[t0, i] < 0
            t = of(np.concatenate([x, [0.5 * (x[b] + x[c])]]), t.cells, fluid)
            more = len(t.cells)
            t.cells = np.concatenate([t.cells, np.zeros((2, 3), dtype=np.int32)])
            t.neighbours = np.concatenate([t.neighbours, np.full((2, 3), -1, dtype=np.int32)])
            t.fluid = np.concatenate([t.fluid, np.full(2, -1, dtype=np.int32)])
            launch(split_edge, t.cells, t.neighbours, t.corner, t.fluid, t0, i, len(x), more + 1, more)
            assert (t.fluid[more:] >= 0).tolist() == [not hull, True]
            t.compact()
            check(t)
            assert ((t.cells == len(x)).any(axis=1)).sum() == (2 if hull else 4)
            assert not ((t.cells == b).any(axis=1) & (t.cells == c).any(axis=1)).any()
            np.testing.assert_allclose(
                np.bincount(t.fluid, weights=simplex_measure(t.state[:, :2], t.cells)),
                np.bincount(fluid, weights=simplex_measure(x, first.cells)),
                rtol=1e-12,
            )


def test_a_star_goes_round_its_particle():
    for seed in range(10):
        x = cloud("walls", seed)
        t = of(x, delaunay(x))
        on_hull = np.unique(border(t, hull=True))
        for p in range(len(x)):
            star, result = np.empty(edge_operations.STAR + 1, dtype=np.int32), np.zeros(2, dtype=np.int32)
            launch(star_of, t.cells, t.neighbours, t.corner, p, star, result)
            around = star[: result[0]]
            assert sorted(around) == np.flatnonzero((t.cells == p).any(axis=1)).tolist()
            assert result[1] == (p not in on_hull)
            place = np.argmax(t.cells[around] == p, axis=1)
            starts, ends = t.cells[around, (place + 1) % 3], t.cells[around, (place + 2) % 3]
            assert starts[1:].tolist() == ends[:-1].tolist()
            assert (starts[0] == ends[-1]) == result[1]


def test_a_star_of_too_many_cells_is_left_alone():
    for n, expected in ((edge_operations.STAR, edge_operations.STAR), (edge_operations.STAR + 1, 0)):
        angle = 2 * np.pi * np.arange(n) / n
        x = np.concatenate([np.stack([np.cos(angle), np.sin(angle)], axis=1), [[0.0, 0.0]]])
        t = of(x, np.stack([np.arange(n), (np.arange(n) + 1) % n, np.full(n, n)], axis=1))
        star, result = np.full(edge_operations.STAR + 4, -7, dtype=np.int32), np.zeros(2, dtype=np.int32)
        launch(star_of, t.cells, t.neighbours, t.corner, n, star, result)
        assert result[0] == expected
        assert (star[edge_operations.STAR + 1 :] == -7).all()


@pytest.mark.slow(but=("random",))
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
                star = np.empty(edge_operations.STAR + 1, dtype=np.int32)
                launch(
                    collapse_edge,
                    t.state,
                    t.cells,
                    t.neighbours,
                    t.corner,
                    t.fluid,
                    t.period.array,
                    star,
                    int(p),
                    int(q),
                    1e-9,
                    done,
                )
                kept = np.where(first.cells == p, q, first.cells)
                kept = kept[~((first.cells == p).any(axis=1) & (first.cells == q).any(axis=1))]
                assert done[0] == (2 * simplex_measure(x, kept)[(kept == q).any(axis=1)] >= 1e-9).all()
                tried += 1
                if done[0]:
                    went += 1
                    t.compact()
                    check(t, removed=1)
                    assert t.corner[p] == -1
                    assert as_set(t.cells) == as_set(kept)
                    assert simplex_measure(x, t.cells).sum() == pytest.approx(1.0, rel=1e-12)
    assert 0.2 * tried < went < tried
