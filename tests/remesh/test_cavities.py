"""Cavities in rounds: who wins against a twin in NumPy, what a change keeps, and the same bits on any processor."""

import hashlib
import itertools
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import taichi as ti
from scipy.spatial import Delaunay

from tipfem.backend import launch as launches
from tipfem.backend.launch import launch
from tipfem.errors import TriangulationError
from tipfem.geometry.place import places
from tipfem.mesh.mesh import Mesh, simplex_measure
from tipfem.remesh.cavity import arrays, cavities, rounds
from tipfem.remesh.cavity.arrays import COLLAPSE, CURE, FIXED, ON, SMOOTH, SPLIT, SWAP
from tipfem.remesh.cavity.cavities import QUALITY, REPAIR, Cavities, Task
from tipfem.remesh.cavity.following import LEAST, followed, improved, qualities

HERE = Path(__file__).parent
DIMENSIONS = (2, 3)


def box(dim: int, n: int, seed: int = 0, labels: int = 2) -> tuple[Mesh, np.ndarray]:
    """Jittered particles in the unit square or cube, a ball of a label, or of two, around its middle; and its walls."""
    rng = np.random.default_rng(seed)
    x = np.stack(np.meshgrid(*dim * [np.linspace(0, 1, n + 1)], indexing="ij"), axis=-1).reshape(-1, dim)
    wall = ((x < 0.5 / n) | (x > 1 - 0.5 / n)).any(axis=1)
    x += ~wall[:, None] * rng.uniform(-0.2 / n, 0.2 / n, x.shape)
    cells = Delaunay(x, qhull_options="Qbb Qc Q12").simplices.astype(np.int32)
    measure = simplex_measure(x, cells)
    cells[measure < 0, :2] = cells[measure < 0, 1::-1]
    cells = cells[(np.abs(measure) > 1e-6 / n**dim) | ~wall[cells].all(axis=1)]
    middle = x[cells].mean(axis=1)
    fluid = (np.linalg.norm(middle - 0.5, axis=1) < 0.28).astype(np.int32)
    fluid[(fluid == 1) & (middle[:, 0] > 0.5)] = labels - 1
    return Mesh(x, cells, fluid), wall


def shaken(dim: int, n: int = 6, seed: int = 0, labels: int = 2) -> Cavities:
    """The same after some motion, at which no cell is inverted."""
    mesh, wall = box(dim, n, seed, labels)
    move = np.random.default_rng(seed + 1).normal(size=mesh.position.shape) * ~wall[:, None] * 0.3 / n
    while (simplex_measure(mesh.position + move, mesh.cells) <= 0.02 * mesh.measure).any():
        move *= 0.8
    return Cavities(mesh.moved(mesh.position + move), wall, 1 / n)


def check(found: Cavities) -> Mesh:
    """The mesh, which is whole: cells have a measure and fill the box, and neighbours know each other."""
    mesh = found.mesh()
    assert (mesh.measure > 0).all()
    assert mesh.measure.sum() == pytest.approx(1.0, rel=1e-12)
    np.testing.assert_array_equal(mesh.neighbours, Mesh(mesh.position, mesh.cells).neighbours)
    used = np.zeros(len(found.x), dtype=bool)
    used[mesh.cells] = True
    np.testing.assert_array_equal(used, found.marks > 0)
    return mesh


def touching(mesh: Mesh) -> int:
    """How many edges, in 2-D particles, there are where more than two faces of the surface of label 1 meet."""
    cell, i = np.nonzero((mesh.neighbours >= 0) & (mesh.fluid[:, None] == 1))
    outer = mesh.fluid[mesh.neighbours[cell, i]] == 0
    face = np.stack([np.delete(mesh.cells[c], k) for c, k in zip(cell[outer], i[outer], strict=True)])
    ridges = [face[:, list(part)] for part in itertools.combinations(range(face.shape[1]), face.shape[1] - 1)]
    number = np.unique(np.sort(np.concatenate(ridges), axis=1), axis=0, return_counts=True)[1]
    assert (number % 2 == 0).all()  # the surface is closed
    return int((number > 2).sum())


def result(found: Cavities) -> str:
    """A hash of all that changes."""
    bits = hashlib.sha256()
    for array in (found.x, found.cells, found.across, found.label, found.marks, found.tried):
        bits.update(np.ascontiguousarray(array).tobytes())
    return bits.hexdigest()


def winners(found: Cavities, row: np.ndarray, real: np.ndarray) -> np.ndarray:
    """The rows that win: by urgency, without its last bits, then by place, at all particles of their cells."""
    left = np.flatnonzero(row[:, arrays.KIND] != arrays.NONE)
    group = {r: np.unique(found.cells[row[r, arrays.CAVITY :][: row[r, arrays.COUNT]]]) for r in left}
    urgency = real[:, arrays.URGENCY].copy().view(np.int64) >> 20
    place = places(found.x)[found.cells[row[:, arrays.CELL]]].sum(axis=1)
    for key in (urgency, place):
        best = np.full(len(found.x), -np.inf)
        for r in left:
            best[group[r]] = np.maximum(best[group[r]], key[r])
        left = np.array([r for r in left if (best[group[r]] == key[r]).all()], dtype=int)
    return left


@pytest.mark.parametrize("serial", [True, False])
@pytest.mark.parametrize("dim", DIMENSIONS)
def test_every_round_changes_what_its_twin_does(dim, serial, monkeypatch):
    """Winners share no particle, nobody waits whom nobody is before, and the mesh is whole after every round."""
    monkeypatch.setattr(launches, "_imposed", [serial, True])
    made: dict[int, int] = {}

    def watched(kernel, *arguments, **options):
        if kernel is not rounds.stake:
            return launch(kernel, *arguments, **options)
        row, real = arguments[1]
        expected = winners(found, row, real)
        launch(kernel, *arguments, **options)
        np.testing.assert_array_equal(np.flatnonzero(row[:, arrays.WON]), expected)
        claimed = [np.unique(found.cells[row[r, arrays.CAVITY :][: row[r, arrays.COUNT]]]) for r in expected]
        assert sum(map(len, claimed)) == len(set().union(*claimed))
        return None

    monkeypatch.setattr(cavities, "launch", watched)
    for seed in range(3):
        found = shaken(dim, 6 if dim == 3 else 14, seed)
        for task in REPAIR[dim]:
            for _ in range(task.most):
                changed = found.round(task)
                check(found)
                made[task.kind] = made.get(task.kind, 0) + changed
                if not changed:
                    break
    assert min(made[task] for task in (SWAP, COLLAPSE, SPLIT)) > 1
    assert dim == 2 or (made[CURE] > 0 and made[SMOOTH] > 0), made


@pytest.mark.parametrize("dim", DIMENSIONS)
def test_cells_are_sorted_by_their_places(dim):
    """They are the same cells, those of empty space still last, and each is close to the next one."""
    found = shaken(dim, 6 if dim == 3 else 14, 0)
    found.run(*REPAIR[dim])
    plain, mesh = found.mesh(empty=True), found.mesh(empty=True, sort=True)
    np.testing.assert_array_equal(*(np.unique(np.sort(each.cells, axis=1), axis=0) for each in (plain, mesh)))
    np.testing.assert_array_equal(mesh.neighbours, Mesh(mesh.position, mesh.cells).neighbours)
    assert (np.diff((mesh.fluid == 0).astype(int)) >= 0).all()
    mixed = np.random.default_rng(0).permutation(mesh.centres())
    near, far = (np.linalg.norm(np.diff(each, axis=0), axis=1).mean() for each in (mesh.centres(), mixed))
    assert near < 0.5 * far


@pytest.mark.parametrize("dim", DIMENSIONS)
def test_changes_keep_what_they_must(dim):
    """Quality rises by swaps; collapses and smoothing keep the volumes of labels; surfaces touch nowhere anew."""
    limits = {2: (0.66, 1.7), 3: (0.75, 1.95)}[dim]
    changes = (
        Task(SWAP, 9, 1e-3 if dim == 2 else 0.3),
        Task(COLLAPSE, 9, limits[0], longest=1.9, least=0.15),
        Task(SPLIT, 9, limits[1] * 0.8),
        Task(CURE, 3, 0.3, longest=1.9, least=1e30),
        Task(SMOOTH, 3, 0.3, gain=0.01),
    )
    for seed in range(3):
        found = shaken(dim, 7 if dim == 3 else 16, seed)
        for task in changes:
            many = touching(found.mesh())
            before, worst = volume(found, 1), qualities(found.mesh()).min() if dim == 3 else 0.0
            assert found.run(task) or task.kind in (CURE, SMOOTH)
            found.mark()
            assert touching(check(found)) <= many
            if task.kind in (SWAP, COLLAPSE, CURE, SMOOTH) or dim == 3:
                assert volume(found, 1) == pytest.approx(before, rel=1e-13)
            if dim == 3 and task.kind in (SWAP, CURE, SMOOTH):
                assert qualities(found.mesh()).min() >= worst


def test_three_labels_and_the_curve_where_they_meet_stay():
    found = shaken(3, 8, labels=3)
    before = found.volumes(found.label, 3)
    for _ in range(3):
        found.repair()
    check(found)
    after = found.volumes(found.label, 3)
    np.testing.assert_allclose(after, before, rtol=0.02)
    assert set(found.label[found.label >= 0]) == {0, 1, 2}


@pytest.mark.parametrize("dim", DIMENSIONS)
def test_a_mesh_at_rest_does_not_change(dim):
    """After the repairs of its first motion no proposal wins any more; particles that are held have not moved."""
    found = shaken(dim, 6 if dim == 3 else 14)
    held = found.marks & FIXED > 0
    places_held = found.x[held].copy()
    for _ in range(4):
        found.repair()
    before = result(found)
    found.repair()
    assert result(found) == before
    np.testing.assert_array_equal(found.x[held], places_held)


@pytest.mark.parametrize("labels", [2, 3])
@pytest.mark.parametrize("dim", DIMENSIONS)
def test_volumes_are_restored(dim, labels):
    found = shaken(dim, 8, labels=labels)
    wanted = found.volumes(found.label, labels)
    wanted[1:] *= 1 + 0.01 * np.arange(1, labels)
    wanted[0] = wanted.sum() - wanted[1:].sum()
    inside, x = found.marks & ON == 0, found.x.copy()
    found.restore_volumes(wanted, found.label)
    np.testing.assert_allclose(found.volumes(found.label, labels)[1:], wanted[1:], rtol=1e-13)
    np.testing.assert_array_equal(found.x[inside], x[inside])


def volume(cavities: Cavities, label: int) -> float:
    """Volume of a label."""
    return cavities.volumes(cavities.label, label + 1)[label]


def moves_of(mesh: Mesh, wall: np.ndarray, rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Particles off the walls, the ends of a long edge each, the first two of the same; and the new places of all."""
    moves, taken = [], set()
    length = np.linalg.norm(mesh.sides(*mesh.edges.T), axis=1)
    for a, b in mesh.edges[np.argsort(-length)].tolist():
        near = set(mesh.cells[np.isin(mesh.cells, [a, b]).any(axis=1)].ravel().tolist())
        free = [p for p in np.flatnonzero(~wall).tolist() if p not in taken | near]
        if not (wall[[a, b]].any() or taken & {a, b}):
            new = [(p, a, b) for p in rng.choice(free, 1 if moves else 2, replace=False)]
            moves += new
            taken |= near | {p for p, *_ in new}
        if len(moves) >= count:
            break
    found, x = np.array(moves), mesh.position.copy()
    found[1, 1:] = found[0, :0:-1]
    part = np.where(np.arange(len(found)) < 2, 1 / 3, 0.5)[:, None]
    x[found[:, 0]] = (1 - part) * mesh.position[found[:, 1]] + part * mesh.position[found[:, 2]]
    return found, x


def test_relocated_particles_go_into_their_edges_and_the_others_stay():
    """Many steps of motion and relocation without Qhull; cells are better than those of a Delaunay mesh."""
    mesh, wall = box(3, 7)
    mesh, rng, done = improved(Mesh(mesh.position, mesh.cells), wall, 1 / 7), np.random.default_rng(5), 0
    for _ in range(15):
        move = rng.normal(size=mesh.position.shape) * ~wall[:, None] * 0.02 / 7
        moves, target = moves_of(mesh.moved(mesh.position + move), wall, rng, 4)
        new = followed(mesh, mesh.position + move, target, moves, wall, 1 / 7)
        if new is None:
            continue
        done += 1
        np.testing.assert_array_equal(new.position, target)
        assert new.used.all()
        assert new.measure.sum() == pytest.approx(1.0, rel=1e-12)
        np.testing.assert_array_equal(new.neighbours, Mesh(target, new.cells).neighbours)
        assert qualities(new).min() > LEAST
        mesh = new
    assert done > 8


def test_what_cannot_follow_is_given_up():
    mesh, wall = box(3, 5)
    nothing = np.zeros((0, 3), dtype=np.int64)
    assert followed(mesh, mesh.position, mesh.position, nothing, wall, 0.2) is not None
    inverted = mesh.position.copy()
    inverted[np.flatnonzero(~wall)[0]] += 0.6
    assert followed(mesh, inverted, inverted, nothing, wall, 0.2) is None
    p, a, b = np.flatnonzero(~wall)[[0, 20, 60]]
    away = mesh.position.copy()
    away[p] = 0.5 * (away[a] + away[b])  # on no edge
    assert followed(mesh, mesh.position, away, np.array([[p, a, b]]), wall, 0.2) is None


RUN = """
import json, sys
import tipfem as tp
sys.path[:0] = sys.argv[3:]
tp.init(arch=sys.argv[1], threads=int(sys.argv[2]) or None)
import test_cavities as tests
print(json.dumps(tests.on_device() if sys.argv[1] != "cpu" else tests.by_threads()))
"""


def by_threads() -> list[str]:
    """The results in both dimensions by many threads, without regard to whether they are worth waking."""
    launches._imposed[:] = [False, True]
    return repaired(shaken(2, 20), shaken(3, 7))


def repaired(*found: Cavities) -> list[str]:
    """The results of a repair in which films break."""
    for each in found:
        each.repair(0.3)
        check(each)
    return [result(each) for each in found]


def on_device() -> list[str]:
    """That in 2-D, with all arrays on the device; the kernels of 3-D take its compiler minutes."""
    types = {"int8": ti.i8, "int32": ti.i32, "int64": ti.i64, "float64": ti.f64}

    def there(kernel, *arguments, **options):
        given = list(arguments)
        for k, array in enumerate(arguments):
            if isinstance(array, np.ndarray):
                given[k] = ti.ndarray(types[array.dtype.name], array.shape)
                given[k].from_numpy(np.ascontiguousarray(array))
        launch(kernel, *given, **options)
        for array, device in zip(arguments, given, strict=True):
            if isinstance(array, np.ndarray):
                array[...] = device.to_numpy()

    cavities.launch = there
    return repaired(shaken(2, 20))


def elsewhere(arch: str, threads: int = 0) -> subprocess.CompletedProcess[str]:
    """`by_threads` in a process of its own."""
    words = [sys.executable, "-c", RUN, arch, str(threads), str(HERE), str(HERE.parent)]
    return subprocess.run(words, capture_output=True, text=True, check=False)


@pytest.mark.slow(but=("4",))
@pytest.mark.parametrize("threads", [1, 2, 4])
def test_any_number_of_threads_gives_the_same_bits(threads, monkeypatch):
    if threads > len(os.sched_getaffinity(0)):
        pytest.skip("the machine has fewer processors")
    monkeypatch.setattr(launches, "_imposed", [True, True])
    done = elsewhere("cpu", threads)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1]) == repaired(shaken(2, 20), shaken(3, 7))


@pytest.mark.slow
@pytest.mark.vulkan
def test_a_device_gives_the_same_bits():
    done = elsewhere("vulkan")
    if "cannot start on 'vulkan'" in done.stderr and os.environ.get("TIPFEM_REQUIRE_VULKAN") != "1":
        pytest.skip("there is no Vulkan driver")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1]) == repaired(shaken(2, 20))


def test_a_repair_with_nothing_to_do_proposes_nothing():
    mesh, wall = box(3, 4)
    found = Cavities(mesh, wall, 0.25)
    found.run(*QUALITY[3])
    assert found.run(*QUALITY[3]) == 0


def test_more_directions_of_walls_than_there_are_bits_are_refused():
    mesh = box(3, 2)[0]
    planes = np.zeros((len(mesh.position), 14), dtype=bool)
    with pytest.raises(TriangulationError, match="14 directions; the mesh tells 13 apart"):
        Cavities(mesh, np.zeros(len(mesh.position), dtype=bool), 0.5, planes=planes)
