"""What `performance.py` measures, in a process of its own for each size and number of threads."""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu
from scipy.spatial import Delaunay

import tipfem as tp
from tipfem import assembly, device, krylov
from tipfem.case import Numerics
from tipfem.device import download
from tipfem.fitting import particle_fluid
from tipfem.flow import FlowProblem
from tipfem.linear_system import LinearSystem
from tipfem.mesh import Mesh
from tipfem.output import ResultsFolder

sys.path.insert(0, str(Path(__file__).parent))
import dam_break

Array = np.ndarray
STATE_TIME = 0.15  # [s], the water runs along the floor
BYTES_OF_A_STEP = 12_500  # a node: what 2.5 Newton iterations of 8 Krylov iterations, and remeshing, must move
COLUMNS = {  # part of a step: where its time is spent
    "set-up": (FlowProblem, "__init__"),
    "residual": (FlowProblem, "residual"),
    "Jacobian": (FlowProblem, "linearise"),
    "products": (FlowProblem, "product"),
    "preconditioner": (FlowProblem, "precondition"),
    "orthogonalisation": (krylov._Basis, "extend"),
}


def largest_step(spacing: float) -> float:
    """Largest time step [s] of the dam break with particles ``spacing`` [m] apart."""
    return dam_break.TIME_STEP * float(spacing / dam_break.SPACING) ** 0.5


def make_state(path: Path, spacing: float) -> None:
    """Run the dam break to `STATE_TIME` with particles ``spacing`` [m] apart, and keep the state in a file."""
    tp.init()
    simulation = tp.Simulation(dam_break.build(spacing), time_step=largest_step(spacing))
    simulation.run(STATE_TIME, progress=False)
    p, mesh = simulation.particles, simulation.mesh
    np.savez(
        path, position=p.position, velocity=p.velocity, acceleration=p.acceleration, pressure=p.pressure, wall=p.wall,
        cells=mesh.cells, fluid=mesh.fluid, spacing=spacing,
    )  # fmt: skip


def refined(state: dict[str, Array]) -> dict[str, Array]:
    """Every triangle cut into four at the middle of its edges; what particles carry is interpolated."""
    cells, count = state["cells"], len(state["position"])
    sides = np.sort(np.stack([cells[:, [1, 2]], cells[:, [2, 0]], cells[:, [0, 1]]], axis=1).reshape(-1, 2), axis=1)
    edges, side, uses = np.unique(sides, axis=0, return_inverse=True, return_counts=True)
    middle = (count + side.reshape(-1, 3)).astype(np.int32)
    a, b, c = cells.T
    ma, mb, mc = middle.T
    new = {
        name: np.concatenate([state[name], state[name][edges].mean(axis=1)])
        for name in ("position", "velocity", "acceleration", "pressure")
    }
    new["cells"] = np.concatenate(
        [np.stack(t, axis=1) for t in ((a, mc, mb), (mc, b, ma), (mb, ma, c), (ma, mb, mc))]
    ).astype(np.int32)
    new["fluid"] = np.tile(state["fluid"], 4)
    new["wall"] = np.concatenate([state["wall"], uses == 1])
    new["spacing"] = state["spacing"] / 2
    return new


def simulation_of(state: dict[str, Array], numerics: Numerics | None = None) -> tp.Simulation:
    """A dam break that goes on from a state."""
    fluids = [dam_break.WATER, dam_break.AIR]
    mesh = Mesh(state["position"], state["cells"], state["fluid"])
    spacing = float(state["spacing"])
    density = np.array([f.density for f in fluids])
    particles = tp.Particles(
        position=state["position"], fluid=particle_fluid(mesh, len(mesh.position), density), wall=state["wall"],
        spacing=spacing, velocity=state["velocity"], acceleration=state["acceleration"], pressure=state["pressure"],
    )  # fmt: skip
    numerics = numerics or Numerics(largest_move=dam_break.LARGEST_MOVE)
    case = tp.Case(particles, fluids, gravity=(0, -dam_break.GRAVITY), numerics=numerics)
    return tp.Simulation(case, time_step=largest_step(spacing))


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
                device.finish()
                self.seconds[name] += time.perf_counter() - start

        setattr(owner, attribute, timed)


def copy_speed(nodes: int) -> float:
    """Bytes read and written per second [1/s] when as much is copied as a step must move, at most 1 GB."""
    n = min(int(nodes * BYTES_OF_A_STEP / 16), 60_000_000)
    buffers = device.Buffers()
    source, target = buffers.get("source", n), buffers.get("target", n)
    source.fill(1.0)
    best = np.inf
    for _ in range(5):
        start = time.perf_counter()
        device.copy(source, target, n)
        device.finish()
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
    watch.watch("remeshing", simulation.remesher, "remesh")
    speed, total = copy_speed(nodes), []
    for _ in range(steps):
        start = time.perf_counter()
        simulation.step()
        device.finish()
        total.append(time.perf_counter() - start)
    rows = simulation.history[-steps:]
    parts = {name: seconds / steps for name, seconds in watch.seconds.items()}
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
        "nodes": nodes, "step": float(np.mean(total)), "parts": parts, "output": output, "qhull": qhull,
        "newton": newton / steps, "krylov": krylov_iterations / newton, "copy": speed,
        "memory": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024,
    }  # fmt: skip


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
        device.finish()
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
    device.finish()
    gather = time.perf_counter() - start

    def solve() -> tuple[float, Any]:
        begin = time.perf_counter()
        result = krylov.fgmres(
            problem.product, problem.precondition, problem._r, problem._dx, problem.size, tolerance=1e-6,
            max_iterations=80, buffers=problem.buffers,
        )  # fmt: skip
        return time.perf_counter() - begin, result

    solve()
    taken, result = solve()
    found = {"iterations": result.iterations, "ours": build + gather + taken}
    v, out = problem.buffers.get("krylov.v", problem.size), problem.buffers.get("krylov.w", problem.size)
    found["product"] = _best(lambda: problem.product(v, out))
    s = problem.scheme
    found["matrix_free_product"] = _best(
        lambda: assembly.jacobian_product(
            *problem._topology, problem._density, problem._record, problem._scale, v, problem._local, out,
            s.cm, s.cv, s.cf, problem.elements, problem.nodes, problem.dimension,
        )
    )  # fmt: skip
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

    ours, problem.system.multigrid.apply = problem.system.multigrid.apply, apply  # type: ignore[method-assign]
    taken, result = solve()
    problem.system.multigrid.apply = ours  # type: ignore[method-assign]
    return {"pyamg": taken + setup, "pyamg_iterations": result.iterations}


def _best(function: Callable[[], None], times: int = 20) -> float:
    best = np.inf
    for _ in range(times):
        start = time.perf_counter()
        function()
        device.finish()
        best = min(best, time.perf_counter() - start)
    return float(best)
