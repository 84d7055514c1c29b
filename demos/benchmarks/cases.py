"""What `performance.py` measures, in a process of its own for each size and number of threads."""

from __future__ import annotations

import resource
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu
from scipy.spatial import Delaunay
from tipfem.demos.benchmarks.states import simulation_of

import tipfem as tp
from tipfem.backend.arrays import Buffers, download
from tipfem.backend.launch import launch
from tipfem.fem import residual
from tipfem.linalg import fgmres, vector_kernels
from tipfem.output import ResultsFolder
from tipfem.step.flow import FlowProblem
from tipfem.step.linear_system import LinearSystem

Array = NDArray[Any]
BYTES_OF_A_STEP = 12_500  # a node: what 2.5 Newton iterations of 8 Krylov iterations, and remeshing, must move
COLUMNS = {  # part of a step: where its time is spent
    "set-up": (FlowProblem, "__init__"),
    "residual": (FlowProblem, "residual"),
    "Jacobian": (FlowProblem, "linearise"),
}
# What an iteration of Krylov's method does; a processor does it in one launch, whose time is shared out as launches of
# each take.
SHARED = ("products", "preconditioner", "orthogonalisation")


class Stopwatch:
    """Adds up the time that functions take; patches them, for this process only."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)

    def watch(self, name: str, owner: Any, attribute: str) -> None:
        """Count the time in ``owner.attribute`` under a name."""
        original: Callable[..., Any] = getattr(owner, attribute)

        def timed(*arguments: Any, **options: Any) -> Any:
            start = time.perf_counter()
            try:
                return original(*arguments, **options)
            finally:
                ti.sync()
                self.seconds[name] += time.perf_counter() - start

        setattr(owner, attribute, timed)


def copy_speed(nodes: int) -> float:
    """Bytes read and written per second [1/s] when as much is copied as a step must move, at most 1 GB."""
    n = min(int(nodes * BYTES_OF_A_STEP / 16), 60_000_000)
    buffers = Buffers()
    source, target = buffers.get("source", n), buffers.get("target", n)
    source.fill(1.0)
    best = np.inf
    for _ in range(5):
        start = time.perf_counter()
        launch(vector_kernels.move, source, 0, target, 0, n, work=(n, 2.0))
        ti.sync()
        best = min(best, time.perf_counter() - start)
    return 16 * n / best


def measure_steps(state: dict[str, Array], steps: int) -> dict[str, Any]:
    """Time of a step and of its parts [s], iterations, memory, copy speed."""
    simulation = simulation_of(state)
    for _ in range(2):  # kernels are compiled or loaded
        simulation.step()
    watch, nodes = Stopwatch(), len(simulation.particles)
    for name, (owner, attribute) in COLUMNS.items():
        watch.watch(name, owner, attribute)
    watch.watch("Krylov", fgmres, "fgmres")
    watch.watch("remeshing", simulation.remesher, "remesh")
    total = []
    for _ in range(steps):
        start = time.perf_counter()
        simulation.step()
        ti.sync()
        total.append(time.perf_counter() - start)
    rows = simulation.history[-steps:]
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024  # before anything large is copied
    speed = copy_speed(nodes)
    solves = watch.seconds.pop("Krylov") / steps
    parts = {name: seconds / steps for name, seconds in watch.seconds.items()}
    parts |= {name: solves * share for name, share in _shares(simulation).items()}
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        results = ResultsFolder(folder)
        results.write_fields(0, 0.0, simulation.mesh, simulation.particles, np.zeros(nodes))
        output = time.perf_counter() - start
    start = time.perf_counter()
    Delaunay(simulation.particles.position)
    qhull = time.perf_counter() - start
    newton, krylov_iterations = (sum(row[name] for row in rows) for name in ("newton_iterations", "krylov_iterations"))
    return {
        "nodes": nodes,
        "step": float(np.mean(total)),
        "parts": parts,
        "output": output,
        "qhull": qhull,
        "newton": newton / steps,
        "krylov": krylov_iterations / newton,
        "copy": speed,
        "memory": memory,
    }


def _shares(simulation: tp.Simulation) -> dict[str, float]:
    """Which part of a Krylov iteration each of `SHARED` takes, by launches of their own in one more step."""
    original, found = FlowProblem.correct, []

    def correct(problem: FlowProblem, x: Any, tolerance: float) -> Any:
        result = original(problem, x, tolerance)
        if not found:
            size, k = problem.size, 3
            v, z, w = (problem.buffers.get(f"krylov.{name}", size) for name in "vzw")
            basis = fgmres._Basis(size, 1e-3, problem.buffers)
            partial, out = problem.buffers.partials("krylov.dots", k + 2, flat=True), np.zeros(k + 3)
            again = (k, basis.orthonormal, basis.directions, w, partial, out, 0.0, True)
            launch(vector_kernels.move, problem._r, 0, v, 0, size, work=(size, 2.0))
            found.append(_best(lambda: problem.product(v, w)))
            found.append(_best(lambda: problem.precondition(v, z)))
            found.append(_best(lambda: basis.by_parts(problem.product, problem.precondition)(*again)))
        return result

    FlowProblem.correct = correct  # type: ignore[method-assign]
    simulation.step()
    FlowProblem.correct = original  # type: ignore[method-assign]
    return dict(zip(SHARED, (np.array(found) / sum(found)).tolist(), strict=True))


def measure_solvers(state: dict[str, Array], direct: bool) -> dict[str, Any]:
    """The first Newton system of a step: our solve to 1e-6, and the same matrix by direct solvers and pyamg."""
    simulation = simulation_of(state)
    simulation.step()
    found: dict[str, Any] = {}
    original, build = FlowProblem.correct, LinearSystem.__init__
    seconds = {"build": 0.0}

    def timed_build(self: LinearSystem, *arguments: Any) -> None:
        start = time.perf_counter()
        build(self, *arguments)
        ti.sync()
        seconds["build"] = time.perf_counter() - start

    def correct(problem: FlowProblem, x: Any, tolerance: float) -> Any:
        if not found:
            found["nodes"] = problem.nodes
            found.update(_solvers(problem, x, seconds["build"], direct))
        return original(problem, x, tolerance)

    FlowProblem.correct, LinearSystem.__init__ = correct, timed_build  # type: ignore[method-assign]
    simulation.step()
    FlowProblem.correct, LinearSystem.__init__ = original, build  # type: ignore[method-assign]
    return found


def _solvers(problem: FlowProblem, x: Any, build: float, direct: bool) -> dict[str, Any]:
    start = time.perf_counter()
    problem.linearise()
    ti.sync()
    gather = time.perf_counter() - start

    def solve() -> tuple[float, Any]:
        begin = time.perf_counter()
        result = fgmres.fgmres(
            problem.product,
            problem.precondition,
            problem._r,
            problem._dx,
            problem.size,
            tolerance=1e-6,
            max_iterations=80,
            buffers=problem.buffers,
            iteration=problem.system.iteration,
        )
        return time.perf_counter() - begin, result

    solve()
    taken, result = solve()
    found = {"iterations": result.iterations, "ours": build + gather + taken}
    v, out = problem.buffers.get("krylov.v", problem.size), problem.buffers.get("krylov.w", problem.size)
    found["product"] = _best(lambda: problem.product(v, out))
    s = problem.scheme
    found["matrix_free_product"] = _best(
        lambda: residual.jacobian_product(
            *problem._topology,
            problem._density,
            problem._record,
            problem._scale,
            v,
            problem._local,
            out,
            s.cm,
            s.cv,
            s.cf,
            problem.elements,
            problem.nodes,
            problem.dimension,
        )
    )
    matrix, right = problem.system.matrix(), download(problem._r, problem.size).astype(float)
    count = matrix.nnz // (problem.dimension + 1) ** 2
    found["product_bytes"] = count * (9 * 8 + 4) + problem.nodes * (6 * 8 + 4)
    found["copy"] = copy_speed(problem.nodes)
    found |= _with_pyamg(problem, solve)
    if direct:
        # Rows of what is held are empty; one pressure of a closed tank is free.
        empty = np.flatnonzero(np.asarray(abs(matrix).sum(axis=1)).ravel() == 0)
        held = np.append(empty, problem.size - 1)
        keep = np.ones(problem.size)
        keep[held] = 0.0
        closed = (sparse.diags(keep) @ matrix + sparse.diags(1.0 - keep)).tocsr()
        right[held] = 0.0
        start = time.perf_counter()
        splu(closed.tocsc()).solve(right)
        found["superlu"] = time.perf_counter() - start
        try:
            import pypardiso
        except ImportError:
            return found
        start = time.perf_counter()
        pypardiso.PyPardisoSolver().solve(closed, right)
        found["pardiso"] = time.perf_counter() - start
    return found


def _with_pyamg(problem: FlowProblem, solve: Callable[[], tuple[float, Any]]) -> dict[str, Any]:
    """The same solve with one V-cycle of smoothed aggregation instead of the background grid's."""
    try:
        import pyamg
    except ImportError:
        return {}
    start = time.perf_counter()
    hierarchy = pyamg.smoothed_aggregation_solver(problem.system.laplacian())
    cycle = hierarchy.aspreconditioner(cycle="V")
    setup = time.perf_counter() - start

    def apply(b: Any, x: Any) -> None:
        problem.buffers.upload("schur_x", cycle @ download(b, problem.nodes).astype(float))

    grid = problem.system.multigrid
    ours, grid.apply, grid.together = grid.apply, apply, False  # type: ignore[method-assign]
    solve()  # kernels that are not for a team
    taken, result = solve()
    grid.apply, grid.together = ours, True  # type: ignore[method-assign]
    return {"pyamg": taken + setup, "pyamg_iterations": result.iterations}


def _best(function: Callable[[], None], times: int = 20) -> float:
    best = np.inf
    for _ in range(times):
        start = time.perf_counter()
        function()
        ti.sync()
        best = min(best, time.perf_counter() - start)
    return float(best)
