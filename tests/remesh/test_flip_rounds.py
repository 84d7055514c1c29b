"""Flips in rounds against a twin in NumPy: what each round flips, by any number of threads, and on a device."""

import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import taichi as ti
from triangulations import KINDS, as_set, check, cloud, delaunay, inner_edges, masses, of, shuffled

from tipfem.backend import launch as launches
from tipfem.backend.array_types import Longs1, Reals1
from tipfem.backend.launch import kernel, launch
from tipfem.geometry.place import places
from tipfem.mesh.mesh import simplex_measure
from tipfem.remesh import claims
from tipfem.remesh.triangles import flips, triangulation
from tipfem.remesh.triangles.edge_operations import ACCELERATION, MASS, STALE, VELOCITY, TriangleArrays

HERE = Path(__file__).parent
TOLERANCE = 1e-9


def mixed(kind: str, seed: int):
    """A triangulation of two fluids with random velocities, in which edges were flipped at random."""
    rng = np.random.default_rng(seed)
    x = cloud(kind, seed)
    cells = delaunay(x)
    fluid = (x[cells].mean(axis=1) @ [1.0, 0.3] > 0.7 * np.ptp(x[:, 0])).astype(int)
    t = of(x, cells, fluid, density=[1000.0, 1.0])
    shuffled(t, seed)
    t.state[:, VELOCITY:ACCELERATION] = rng.normal(size=x.shape)
    t.state[:, MASS] = masses(t)
    return t


def result(t) -> str:
    """A hash of all that flips change."""
    bits = hashlib.sha256()
    for array in (t.state, t.cells, t.neighbours, t.fluid, t.corner, t._stale):
        bits.update(np.ascontiguousarray(array).tobytes())
    return bits.hexdigest()


def wanted(t) -> tuple[np.ndarray, np.ndarray]:
    """The four particles (K, 4) around each edge that is to be flipped, and its excess, in NumPy."""
    x, four = t.state[:, :2], inner_edges(t)
    v = x[four[:, :3]] - x[four[:, 3:]]
    square = (v**2).sum(axis=2)
    beside = (x[four[:, 1:3]] - x[four[:, :1]]) ** 2
    largest = np.maximum(square[:, 0], np.minimum(square[:, 1:].max(axis=1), beside.sum(axis=2).max(axis=1)))
    excess = np.linalg.det(np.concatenate([v, square[..., None]], axis=2)) / largest**2
    a, b, c, d = four.T
    convex = (simplex_measure(x, np.stack([a, b, d], 1)) > 0) & (simplex_measure(x, np.stack([a, d, c], 1)) > 0)
    keep = (excess > TOLERANCE) & convex
    return four[keep], excess[keep]


def winners(four: np.ndarray, *keys: np.ndarray) -> np.ndarray:
    """Which of K groups of four are best at all of their particles: by the first key, and of the equal by the next."""
    left = np.arange(len(four))
    for key in keys:
        best = np.full(four.max(initial=0) + 1, -np.inf)
        np.maximum.at(best, four[left].ravel(), np.repeat(key[left], 4))
        left = left[(best[four[left]] == key[left, None]).all(axis=1)]
    return left


def flipped(t, four: np.ndarray) -> set[tuple[int, ...]]:
    """The cells, without their order, after flips of the edges in the middle of these groups of four."""
    cells = as_set(t.cells)
    for a, b, c, d in four.tolist():
        cells -= {tuple(sorted(cell)) for cell in ((a, b, c), (b, c, d))}
        cells |= {tuple(sorted(cell)) for cell in ((a, b, d), (a, c, d))}
    return cells


@pytest.fixture
def in_parallel(monkeypatch):
    """All rounds as with many threads and edges."""
    monkeypatch.setattr(launches, "_imposed", [False, True])


@pytest.mark.usefixtures("in_parallel")
@pytest.mark.parametrize("kind", ["random", "jittered lattice", "stretched", "walls"])
def test_every_round_flips_what_its_twin_does(kind, monkeypatch):
    """Listed are all edges that are to be flipped, flipped are the winners; the mesh is whole after every round."""
    made = []

    def watched(kernel, *arguments, **options):
        if kernel is not flips.flip_round:
            return launch(kernel, *arguments, **options)
        names, row, count = arguments[1].names, *arguments[-2:]
        four, excess = wanted(t)
        name = names[row, :count]
        listed = np.sort(np.stack([t.cells[name // 3, (name % 3 + k) % 3] for k in (1, 2)], axis=1), axis=1)
        assert len(listed) == len(four)
        assert as_set(listed) == as_set(four[:, 1:3])
        place = places(t.state[:, :2])
        won = winners(four, excess, place[four[:, 1:3]].sum(axis=1))
        assert len(won)
        expected = flipped(t, four[won])
        launch(kernel, *arguments, **options)
        check(t)
        assert as_set(t.cells) == expected
        np.testing.assert_allclose(t.state[:, MASS], masses(t), atol=1e-12 * masses(t).sum())
        made.append(len(won))
        return None

    monkeypatch.setattr(triangulation, "launch", watched)
    total = 0
    for seed in range(10):
        t = mixed(kind, seed)
        made.clear()
        assert t.make_delaunay(TOLERANCE) == sum(made)
        assert not len(wanted(t)[0])
        total += sum(made)
    assert total > 100


@pytest.mark.parametrize("kind", KINDS)
def test_one_thread_and_many_give_the_same_bits(kind, monkeypatch):
    """Rounds by a kernel alone, one by one, and some of each."""
    total = 0
    for seed in range(12):
        found = set()
        for schedule in ("alone", "rounds", "both"):
            t = mixed(kind, seed)
            monkeypatch.setattr(launches, "_imposed", [schedule == "alone", True])
            first = iter([False])
            monkeypatch.setattr(
                triangulation,
                "is_serial",
                lambda *_, s=schedule, f=first: s == "alone" or (s == "both" and next(f, True)),
            )
            total += t.make_delaunay(TOLERANCE)
            check(t)
            found.add(result(t))
        assert len(found) == 1
    assert total > 60


def test_what_is_flipped_depends_on_no_numbering():
    """Many edges of a lattice have the same excess, and as many answers are right: places decide."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        x = np.stack(np.meshgrid(np.arange(9.0), np.arange(9.0)), axis=-1).reshape(-1, 2)
        x[:, 0] += 2 * x[:, 1]  # so that a lattice's own triangles are far from Delaunay
        index = np.arange(81).reshape(9, 9)
        a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]))
        cells = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
        one = of(x, cells)
        order, number = rng.permutation(81), np.empty(81, dtype=int)
        number[order] = np.arange(81)
        turned = np.take_along_axis(cells, (np.arange(3) + rng.integers(0, 3, (len(cells), 1))) % 3, axis=1)
        other = of(x[order], number[rng.permutation(turned)])
        assert one.make_delaunay(1e-13) == other.make_delaunay(1e-13) > 40
        assert as_set(order[other.cells]) == as_set(one.cells)


@kernel
def whole_numbers(values: Reals1, urgency: Longs1, place: Longs1):
    for i in range(values.shape[0]):
        urgency[i] = claims.whole_urgency(ti.abs(values[i]))
        place[i] = claims.whole_place(values[i], i % 2)


def test_whole_numbers_are_in_the_order_of_what_they_stand_for():
    """Urgencies, and places of either sign, then names."""
    rng = np.random.default_rng(3)
    values = np.sort(rng.choice([-1.0, 1.0], 1000) * 10.0 ** rng.uniform(-12, 12, 1000))
    values = np.repeat(np.concatenate([values, [0.0]]), 2)
    urgency, place = np.empty(len(values), dtype=np.int64), np.empty(len(values), dtype=np.int64)
    launch(whole_numbers, values, urgency, place)
    assert (place > 0).all()
    assert (place[1::2] == place[::2] + 1).all()  # the name
    by_place, by_size = np.argsort(values[::2]), np.argsort(np.abs(values[::2]))
    assert (np.diff(place[::2][by_place]) > 1).all()
    assert (np.diff(urgency[::2][by_size]) > 0).all()
    assert urgency[-1] == 0
    near = np.array([0.3, 0.3 * (1 + 1e-13), 0.3 * (1 + 1e-8)])
    launch(whole_numbers, near, urgency := np.empty(3, dtype=np.int64), np.empty(3, dtype=np.int64))
    assert urgency[0] == urgency[1] < urgency[2]  # round-off decides nothing


RUN = """
import json, sys
import numpy as np
import tipfem as tp
sys.path[:0] = sys.argv[3:]
tp.init(arch=sys.argv[1], threads=int(sys.argv[2]) or None)
import test_flip_rounds as tests
print(json.dumps(tests.on_device() if sys.argv[1] != "cpu" else tests.by_threads()))
"""


def large():
    """A triangulation of 3 700 particles that has hundreds of edges to flip in its first rounds."""
    rng = np.random.default_rng(1)
    x = np.stack(np.meshgrid(np.arange(61.0), np.arange(61.0)), axis=-1).reshape(-1, 2)
    inner = ((x > 0) & (x < 60)).all(axis=1)
    cells = delaunay(x + rng.uniform(-1e-6, 1e-6, x.shape) * inner[:, None])
    x[inner] += rng.uniform(-0.25, 0.25, (inner.sum(), 2))
    t = of(x, cells, x[cells].mean(axis=1)[:, 0] > 31.3, density=[1.0, 1000.0])
    t.state[:, VELOCITY:ACCELERATION] = rng.normal(size=x.shape)
    return t


def by_threads() -> str:
    """The result of many threads, without regard to whether they are worth waking."""
    launches._imposed[:] = [False, True]
    t = large()
    assert t.make_delaunay(1e-3) > 1000
    return result(t)


def on_device() -> str:
    """The same, by kernels on arrays of the device."""
    t = large()
    t._stale[:] = STALE
    size, zeros = 3 * len(t.cells), np.zeros
    lists = zeros((2, size), np.int32), zeros((2, size)), zeros(4 * size, np.int32), zeros(flips.COUNTERS, np.int32)
    held = zeros(len(t.state), np.int64), zeros(len(t.state), np.int64)
    types = {"int8": ti.i8, "int32": ti.i32, "int64": ti.i64, "float64": ti.f64}

    def there(array: np.ndarray) -> ti.Ndarray:
        copy = ti.ndarray(types[array.dtype.name], array.shape)
        copy.from_numpy(np.ascontiguousarray(array))
        return copy

    mesh, edges = TriangleArrays(*map(there, t._arrays)), flips.Edges(*map(there, lists))
    given = mesh, edges, claims.Claims(*map(there, held)), 1e-3
    launch(flips.make_delaunay, *given, work=(len(t.cells), flips.LIST_EDGES))
    row = 0
    while listed := int(edges.counters.to_numpy()[flips.LISTED + row]):
        launch(flips.flip_round, *given, row, listed)
        row = 1 - row
    for array, copy in zip(t._arrays, mesh, strict=True):
        array[:] = copy.to_numpy()
    check(t)
    return result(t)


def elsewhere(arch: str, threads: int = 0) -> subprocess.CompletedProcess[str]:
    """`large` made Delaunay in a process of its own."""
    return subprocess.run(
        [sys.executable, "-c", RUN, arch, str(threads), str(HERE), str(HERE.parent)],
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.slow
@pytest.mark.usefixtures("in_parallel")
def test_any_number_of_threads_gives_the_same_bits():
    expected = by_threads()
    for threads in (1, 2, 4):
        if threads <= len(os.sched_getaffinity(0)):
            done = elsewhere("cpu", threads)
            assert done.returncode == 0, done.stderr
            assert json.loads(done.stdout.splitlines()[-1]) == expected


@pytest.mark.slow
@pytest.mark.vulkan
@pytest.mark.usefixtures("in_parallel")
def test_a_device_gives_the_same_bits():
    """With all loops flat: the software driver ends inner loops that have atomic operations in them."""
    done = elsewhere("vulkan")
    if "cannot start on 'vulkan'" in done.stderr and os.environ.get("TIPFEM_REQUIRE_VULKAN") != "1":
        pytest.skip("there is no Vulkan driver")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1]) == by_threads()
