"""Runs do not depend on the order in which particles and fluids are listed, up to round-off."""

import numpy as np
import pytest
import taichi as ti
from scipy.spatial import cKDTree

import tipfem as tp
from tipfem.backend.array_types import Array1, Array2
from tipfem.backend.launch import kernel, launch
from tipfem.remesh.triangles.queue import Queue, drop_first, push

WATER = tp.Fluid("water", density=998.2, viscosity=1.002e-3)
AIR = tp.Fluid("air", density=1.204, viscosity=1.825e-5)
SPACING, ACROSS = 0.02, 13
SIDE = SPACING * ACROSS


def simulation(kind: str, order: np.ndarray | None = None) -> tp.Simulation:
    """A jittered cloud in a square tank that a vortex stirs, its particles and fluids in another ``order``."""
    rng = np.random.default_rng(4)
    x = np.stack(np.meshgrid(*2 * [np.arange(ACROSS + 1.0)], indexing="ij"), axis=-1).reshape(-1, 2)
    on = (x == 0) | (x == ACROSS)
    wall = on.any(axis=1)
    jitter = rng.uniform(-0.3, 0.3, x.shape)
    x += np.where(wall[:, None], np.where(on.all(axis=1)[:, None] | on, 0.0, 0.6 * jitter), jitter)
    x *= SPACING
    water = (x[:, 0] < 0.55 * SIDE) & (x[:, 1] < 0.6 * SIDE)
    a, b = np.pi * x.T / SIDE
    velocity = 1.2 * np.stack([np.sin(a) ** 2 * np.sin(2 * b), -np.sin(2 * a) * np.sin(b) ** 2], axis=1)
    velocity[wall] = 0
    fluids = [WATER] if kind in ("one", "free") else [WATER, AIR]
    label = np.zeros(len(x), dtype=int)
    if len(fluids) == 2:
        label = rng.integers(0, 2, len(x)) if kind == "mixed" else np.where(water, 0, 1)
    kept = water | wall if kind == "free" else np.ones(len(x), dtype=bool)
    index = np.flatnonzero(kept)
    if order is not None:
        index, fluids, label = index[order], fluids[::-1], len(fluids) - 1 - label
    particles = tp.Particles(x[index], label[index], wall[index], velocity=velocity[index], spacing=SPACING)
    return tp.Simulation(
        tp.Case(
            particles,
            fluids,
            (0, -9.81),
            interface="interpolated" if kind in ("free", "interpolated") else "sharp",
            free_surface=kind == "free",
            grading=tp.Grading({"air": 0.04}, growth=0.3) if kind == "graded" else None,
            numerics=tp.Numerics(pressure="two-sided" if kind in ("two-sided", "mixed") else "continuous"),
        ),
        time_step=4e-3,
    )


@pytest.mark.parametrize("kind", ["one", "two", "two-sided", "mixed", "graded", "interpolated", "free"])
def test_a_run_depends_on_no_order(kind):
    """Every step, what remeshing does included, is the same to round-off."""
    one = simulation(kind)
    order = np.random.default_rng(1).permutation(len(one.particles))
    other = simulation(kind, order)
    relocated = 0
    for _ in range(8):
        one.step()
        other.step()
        relocated += one.state.relocations
        assert other.state.relocations == one.state.relocations
        distance, match = cKDTree(other.particles.position).query(one.particles.position)
        assert len(np.unique(match)) == len(match) == len(other.particles)
        assert distance.max() < 1e-11 * SPACING
        for name, scale in (("velocity", 1.0), ("pressure", np.ptp(one.particles.pressure))):
            mine, theirs = (getattr(s.particles, name) for s in (one, other))
            np.testing.assert_allclose(theirs[match], mine, rtol=0, atol=1e-10 * scale)
        cells = (np.sort(c, axis=1) for c in (match[one.mesh.cells], other.mesh.cells))
        assert len(set.symmetric_difference(*({tuple(c) for c in part.tolist()} for part in cells))) == 0
        for fluid in one.case.fluids:
            assert other.volume(fluid.name) == pytest.approx(one.volume(fluid.name), rel=1e-13)
    assert relocated > 3


@kernel
def sort_by_queue(given: Array2, keys: Array2, names: Array1, result: Array1):
    queue = ti.static(Queue(keys, names))
    ti.loop_config(serialize=True)
    for _ in range(1):
        size = 0
        for k in range(given.shape[0]):
            size = push(queue, size, given[k, 0], given[k, 1], k)
        for k in range(given.shape[0]):
            result[k] = names[0]
            size = drop_first(queue, size)


def test_a_queue_gives_the_largest_keys_first():
    rng = np.random.default_rng(7)
    for count in (1, 2, 3, 10, 100):
        given = np.stack([rng.integers(0, 5, count), rng.uniform(size=count)], axis=1).astype(float)
        result = np.empty(count, dtype=np.int32)
        launch(sort_by_queue, given, np.empty((count, 2)), np.empty(count, dtype=np.int32), result)
        np.testing.assert_array_equal(result, np.lexsort((-given[:, 1], -given[:, 0])))
