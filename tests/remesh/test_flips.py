"""Flips against Qhull, and what becomes of momentum."""

import numpy as np
import pytest
from triangulations import (
    KINDS,
    as_set,
    border,
    check,
    circle_test,
    cloud,
    delaunay,
    inner_edges,
    masses,
    momentum,
    momentum_scale,
    of,
    shuffled,
)

from tipfem.mesh.mesh import simplex_measure
from tipfem.remesh.triangles.edge_operations import ACCELERATION, MASS, VELOCITY
from tipfem.remesh.triangles.triangulation import Crowding, Triangulation


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


def test_after_changes_of_its_own_only_what_changed_is_looked_at():
    """The same flips as after a look at all cells, when particles were put in and taken out."""
    flips = 0
    for seed in range(20):
        x = 8 * cloud("jittered lattice", seed)
        results = []
        for stale_only in (False, True):
            t = of(x, delaunay(x))
            shuffled(t, seed)
            t.make_delaunay(1e-3)
            t.coarsen(t.wall.astype(bool), Crowding(0.8, 0.1, 0.2, 0.0, 0.02), most=len(x))
            assert len(t.removed)
            edges, _ = t.longest_edges(1.5, t.candidates())
            t.refine(edges, 0.1)
            flips += t.make_delaunay(1e-3, stale_only=stale_only)
            results.append((t.state, t.cells, t.neighbours, t.fluid))
        for one, other in zip(*results, strict=True):
            np.testing.assert_array_equal(one, other)
    assert flips > 100


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


def stirred(t: Triangulation, seed: int) -> Triangulation:
    """The triangulation with random velocities, and masses that fit where its particles are."""
    t.state[:, VELOCITY:ACCELERATION] = np.random.default_rng(seed).normal(size=(len(t.state), 2))
    t.state[:, MASS] = masses(t)
    return t


@pytest.mark.parametrize("kind", ["random", "walls", "stretched"])
def test_flips_keep_masses_and_momentum_where_there_are_no_walls(kind):
    """Three fluids with densities of 1 to 1000, random velocities."""
    flips = 0
    for seed in range(20):
        x = cloud(kind, seed)
        cells = delaunay(x)
        fluid = np.random.default_rng(seed).integers(0, 3, len(cells)) if seed % 2 else None
        t = of(x, cells, fluid, wall=np.zeros(len(x)), density=[1.0, 1000.0, 30.0])
        shuffled(t, seed)
        stirred(t, seed)
        before, state, scale = momentum(t), t.state.copy(), momentum_scale(t)
        flips += t.make_delaunay(1e-13)
        np.testing.assert_allclose(momentum(t), before, atol=1e-12 * scale)
        np.testing.assert_allclose(t.state[:, MASS], masses(t), atol=1e-12 * masses(t).sum())
        np.testing.assert_array_equal(t.state[:, [0, 1, 4, 5, 6]], state[:, [0, 1, 4, 5, 6]])
    assert flips > 100


def test_a_flip_beside_a_wall_changes_no_velocity():
    flips = 0
    for seed in range(10):
        x = cloud("random", seed)
        t = of(x, delaunay(x), wall=np.ones(len(x)))
        shuffled(t, seed)
        velocity = stirred(t, seed).state[:, 2:4].copy()
        flips += t.make_delaunay(1e-13)
        np.testing.assert_array_equal(t.state[:, VELOCITY:ACCELERATION], velocity)
    assert flips > 100


def test_flips_leave_a_rigid_motion_alone():
    """What moves as one has nothing to give back."""
    x = cloud("jittered lattice", 3)
    t = of(x, delaunay(x), wall=np.zeros(len(x)))
    shuffled(t, 3)
    t.state[:, VELOCITY:ACCELERATION] = [0.7, -0.3]
    t.state[:, MASS] = masses(t)
    assert t.make_delaunay(1e-13) > 10
    np.testing.assert_allclose(t.state[:, VELOCITY:ACCELERATION], np.tile([0.7, -0.3], (len(x), 1)), atol=1e-13)
