"""What `performance.py` measures, in a process of its own for each size and number of threads."""

import importlib.metadata
import os
import resource
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu
from scipy.spatial import Delaunay
from tipfem.demos.benchmarks.states import first_system, simulation_of

import tipfem as tp
from tipfem.linalg import fgmres
from tipfem.results.output import ResultsFolder
from tipfem.step.linear_system import Workspace
from tipfem.step.problem import FlowProblem
from tipfem.timers import Timings

Array = NDArray[Any]
Operator = Callable[[Any, Any], None]

BYTES_OF_A_STEP = 12_500  # a particle: what 2.5 Newton iterations of 8 Krylov iterations, and remeshing, must move
TIMERS = {"set-up": "set-up", "residual": "residual", "Jacobian": "jacobian"}  # part of a step: its timer
# What an iteration of Krylov's method does. On a processor it is done in one launch, whose time is divided among them
# as they take when each is launched by itself.
SHARED = ("products", "preconditioner", "orthogonalisation")


@ti.kernel
def _copy(source: ti.types.ndarray(ndim=1), target: ti.types.ndarray(ndim=1), n: ti.i32):
    for i in range(n):
        target[i] = source[i]


def timer_seconds(timings: Timings, name: str) -> float:
    """Seconds under all timers of that name, whatever they are nested in."""
    return sum(seconds for path, seconds in timings.seconds.items() if path.rpartition("/")[2] == name)


def copy_speed(count: int) -> float:
    """Bytes read and written per second [1/s] when as much is copied as a step of ``count`` particles must move.

    At most 1 GB is copied.
    """
    n = min(int(count * BYTES_OF_A_STEP / 16), 60_000_000)
    source, target = ti.ndarray(ti.f64, n), ti.ndarray(ti.f64, n)
    source.fill(1.0)
    return 16 * n / _best(lambda: _copy(source, target, n), times=6)


def measure_steps(state: dict[str, Array], steps: int) -> dict[str, Any]:
    """Time of a step and of its parts [s], of the first one, iterations, memory, copy speed."""
    start = time.perf_counter()
    simulation = simulation_of(state)
    simulation.step()  # kernels are compiled or loaded
    first = time.perf_counter() - start
    simulation.step()
    count = len(simulation.particles)
    timings = simulation.timings
    timings.synchronise = ti.sync
    timings.reset()
    for _ in range(steps):
        simulation.step()
    seconds = {name: timer_seconds(timings, name) / steps for name in ("step", "krylov", "remeshing", *TIMERS.values())}
    rows = simulation.history[-steps:]
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024  # before anything large is copied
    parts = {part: seconds[name] for part, name in TIMERS.items()}
    parts |= {name: seconds["krylov"] * share for name, share in _shares(simulation).items()}
    with tempfile.TemporaryDirectory() as folder:
        results = ResultsFolder(folder)
        start = time.perf_counter()
        results.write_fields(0, 0.0, simulation.mesh, simulation.particles, np.zeros(count))
        output = time.perf_counter() - start
    start = time.perf_counter()
    Delaunay(simulation.particles.position)
    qhull = time.perf_counter() - start
    newton, krylov = (sum(row[name] for row in rows) for name in ("newton_iterations", "krylov_iterations"))
    return {
        "particles": count,
        "step": seconds["step"],
        "first_step": first,
        "parts": parts | {"remeshing": seconds["remeshing"]},
        "output": output,
        "qhull": qhull,
        "newton": newton / steps,
        "krylov": krylov / newton,
        "copy": copy_speed(count),
        "memory": memory,
    }


def _system(simulation: tp.Simulation, workspace: Workspace, jacobian: str = "rows") -> tuple[FlowProblem, float]:
    """The first Newton system of a simulation's next step, and the seconds that its preconditioner took to set up."""
    timings = Timings(ti.sync)
    with timings.active():
        dt = simulation.history[-1]["time_step"]
        problem, _ = first_system(
            simulation.mesh, simulation.particles, simulation.case.fluids, dt, workspace, jacobian
        )
    return problem, timer_seconds(timings, "preconditioner")


def _solve(
    problem: FlowProblem, precondition: Operator | None = None, product: Operator | None = None
) -> tuple[Any, float]:
    """Solve to 1e-6 and tell the seconds; with operators of one's own, each is launched by itself."""
    staged = precondition or product
    start = time.perf_counter()
    result = fgmres.fgmres(
        product or problem.product,
        precondition or problem.precondition,
        problem.buffers.get("residual", problem.size),
        problem.buffers.get("correction", problem.size),
        problem.size,
        tolerance=1e-6,
        max_iterations=80,
        buffers=problem.buffers,
        iterations=None if staged else problem.system.iterations,
    )
    ti.sync()
    return result, time.perf_counter() - start


def _shares(simulation: tp.Simulation) -> dict[str, float]:
    """Which part of a Krylov iteration each of `SHARED` takes when each is launched by itself."""
    problem, _ = _system(simulation, Workspace())
    problem.linearise()
    seconds = dict.fromkeys(SHARED, 0.0)

    def timed(name: str, operator: Operator) -> Operator:
        def apply(v: Any, out: Any) -> None:
            ti.sync()
            start = time.perf_counter()
            operator(v, out)
            ti.sync()
            seconds[name] += time.perf_counter() - start

        return apply

    operators = timed("preconditioner", problem.precondition), timed("products", problem.product)
    _solve(problem, *operators)  # kernels are compiled or loaded
    seconds.update(dict.fromkeys(SHARED, 0.0))
    whole = _solve(problem, *operators)[1]
    seconds["orthogonalisation"] = whole - seconds["products"] - seconds["preconditioner"]
    return {name: value / whole for name, value in seconds.items()}


def measure_solvers(state: dict[str, Array], direct: bool) -> dict[str, Any]:
    """The first Newton system of a step: our solve to 1e-6, and the same matrix by direct solvers and pyamg."""
    simulation, workspace = simulation_of(state), Workspace()
    simulation.step()
    _system(simulation, workspace)  # kernels are compiled or loaded
    problem, build = _system(simulation, workspace)
    problem.linearise()
    ti.sync()
    start = time.perf_counter()
    problem.linearise()
    ti.sync()
    gather = time.perf_counter() - start
    _solve(problem)
    result, taken = _solve(problem)
    count = len(simulation.particles)
    found = {"particles": count, "iterations": result.iterations, "ours": build + gather + taken}
    v, out = problem.buffers.get("correction", problem.size), ti.ndarray(ti.f64, problem.size)
    found["product"] = _best(lambda: problem.product(v, out))
    matrix = problem.system.matrix()
    rhs = _host(problem.buffers.get("residual", problem.size), problem.size)
    blocks = matrix.nnz // (problem.dimension + 1) ** 2
    found["product_bytes"] = blocks * (9 * 8 + 4) + count * (6 * 8 + 4)
    found["copy"] = copy_speed(count)
    found |= _with_pyamg(problem, matrix)
    found |= _direct(matrix, rhs) if direct else {}
    return found | _matrix_free(simulation)


def _matrix_free(simulation: tp.Simulation) -> dict[str, Any]:
    """The same solve without rows of the Jacobian: seconds with set-up, iterations, and seconds of a product."""
    workspace = Workspace()
    _solve(_linearised(simulation, workspace)[0])  # kernels are compiled or loaded
    problem, build = _linearised(simulation, workspace)
    result, taken = _solve(problem)
    v, out = problem.buffers.get("correction", problem.size), ti.ndarray(ti.f64, problem.size)
    product = _best(lambda: problem.product(v, out))
    return {
        "matrix_free": build + taken,
        "matrix_free_iterations": result.iterations,
        "matrix_free_product": product,
    }


def _linearised(simulation: tp.Simulation, workspace: Workspace) -> tuple[FlowProblem, float]:
    """As `_system`, matrix-free and linearised."""
    problem, build = _system(simulation, workspace, "matrix-free")
    problem.linearise()
    return problem, build


def _direct(matrix: sparse.csr_matrix, rhs: Array) -> dict[str, float]:
    """Seconds of direct solvers for K x = b; PARDISO if it is installed."""
    # Rows of what is prescribed are empty; one pressure of a closed tank is free.
    empty = np.flatnonzero(np.asarray(abs(matrix).sum(axis=1)).ravel() == 0)
    held = np.append(empty, len(rhs) - 1)
    keep = np.ones(len(rhs))
    keep[held] = 0.0
    closed = (sparse.diags(keep) @ matrix + sparse.diags(1.0 - keep)).tocsr()
    rhs = keep * rhs
    start = time.perf_counter()
    splu(closed.tocsc()).solve(rhs)
    found = {"superlu": time.perf_counter() - start}
    pypardiso = _import_pardiso()
    if pypardiso is None:
        return found
    start = time.perf_counter()
    pypardiso.PyPardisoSolver().solve(closed, rhs)
    return found | {"pardiso": time.perf_counter() - start}


def _import_pardiso() -> Any | None:
    """The module pypardiso, None where it is not installed.

    It looks for the library of the package mkl in the folder of the running Python only, where it is not if that is a
    virtual environment on top of another.
    """
    try:
        for file in importlib.metadata.files("mkl") or []:
            if file.name.startswith("libmkl_rt.so"):
                os.environ.setdefault("PYPARDISO_MKL_RT", str(Path(str(file.locate())).resolve()))
        import pypardiso
    except ImportError:  # of either package
        return None
    return pypardiso


def _with_pyamg(problem: FlowProblem, matrix: sparse.csr_matrix) -> dict[str, Any]:
    """The same solve with one V-cycle of smoothed aggregation instead of the background grid's, if it is installed.

    The block preconditioner around the cycle, see `tipfem.step.linear_system`, is applied by SciPy: with rows scaled
    so that diag(A) is one, z_p = S^-1 (r_p - D r_u) / scale and z_u = r_u + G z_p.
    """
    try:
        import pyamg
    except ImportError:
        return {}
    width = problem.dimension + 1
    pressure = np.arange(problem.size) % width == problem.dimension
    divergence, gradient = matrix[pressure][:, ~pressure].tocsr(), matrix[~pressure][:, pressure].tocsr()
    scale = _host(problem.buffers.get("scale", problem.size), problem.size)[pressure]
    start = time.perf_counter()
    cycle = pyamg.smoothed_aggregation_solver(problem.system.laplacian()).aspreconditioner(cycle="V")
    setup = time.perf_counter() - start
    z = np.empty(problem.size)

    def precondition(v: Any, out: Any) -> None:
        r = _host(v, problem.size)
        rhs = r[pressure] - divergence @ r[~pressure]
        z[pressure] = p = cycle @ np.divide(rhs, scale, out=np.zeros_like(rhs), where=scale > 0)
        z[~pressure] = r[~pressure] - gradient @ p
        _copy(z, out, problem.size)

    _solve(problem, precondition)  # kernels are compiled or loaded
    result, taken = _solve(problem, precondition)
    return {"pyamg": taken + setup, "pyamg_iterations": result.iterations}


def _host(array: Any, n: int) -> NDArray[np.float64]:
    """The first ``n`` entries of a device array."""
    values = np.empty(n)
    _copy(array, values, n)
    return values


def _best(function: Callable[[], None], times: int = 20) -> float:
    """The least of the seconds that a function takes."""
    best = np.inf
    for _ in range(times):
        start = time.perf_counter()
        function()
        ti.sync()
        best = min(best, time.perf_counter() - start)
    return float(best)
