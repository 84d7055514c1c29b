"""States and systems that `performance.py` measures on."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tipfem.demos.validation.dam_break import case as dam_break

import tipfem as tp
from tipfem.case.boundary.boundary import Boundary
from tipfem.case.fluid import ranks
from tipfem.case.numerics import Numerics
from tipfem.fem.time_integration import GeneralizedAlpha
from tipfem.mesh.delaunay import triangulate
from tipfem.mesh.mesh import Mesh
from tipfem.physics.term import ElementProperties
from tipfem.physics.walls.step import WallsInStep
from tipfem.physics.walls.term import WallTerm
from tipfem.remesh.triangles.fitted import particle_fluid, with_fluids
from tipfem.step.linear_system import Workspace
from tipfem.step.problem import FlowProblem

Array = NDArray[Any]
STATE_TIME = 0.15  # [s], the water runs along the floor


def largest_step(spacing: float) -> float:
    """Largest time step [s] of the dam break with particles ``spacing`` [m] apart."""
    return dam_break.TIME_STEP * float(np.sqrt(spacing / dam_break.SPACING))


def make_state(path: str | Path, spacing: float) -> None:
    """Run the dam break to `STATE_TIME` with particles ``spacing`` [m] apart, and keep the state in a file."""
    tp.init()
    simulation = tp.Simulation(dam_break.build(spacing), time_step=largest_step(spacing))
    simulation.run(STATE_TIME, progress=False)
    p, mesh = simulation.particles, simulation.mesh
    assert mesh.fluid is not None
    np.savez(
        path,
        position=p.position,
        velocity=p.velocity,
        acceleration=p.acceleration,
        pressure=p.pressure,
        wall=p.wall,
        cells=mesh.cells,
        fluid=mesh.fluid,
        spacing=spacing,
    )


def refined(state: dict[str, Array]) -> dict[str, Array]:
    """Every triangle cut into four at the middle of its edges; what particles carry is interpolated.

    Particles and triangles come in an order like that of a run, which starts from a lattice.
    """
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
    new["wall"] = np.concatenate([state["wall"], uses == 1])
    x, y = new["position"].T
    spacing = state["spacing"] / 2
    order = np.lexsort((y, np.floor(x / spacing)))
    number = np.argsort(order).astype(np.int32)
    cells = np.concatenate([np.stack(t, axis=1) for t in ((a, mc, mb), (mc, b, ma), (mb, ma, c), (ma, mb, mc))])
    cells = number[cells]
    by_lowest = np.argsort(cells.min(axis=1), kind="stable")
    new = {name: values[order] for name, values in new.items()}
    return new | {"cells": cells[by_lowest], "fluid": np.tile(state["fluid"], 4)[by_lowest], "spacing": spacing}


def simulation_of(state: dict[str, Array], numerics: Numerics | None = None) -> tp.Simulation:
    """A dam break that goes on from a state, between the walls of the demo."""
    fluids = [dam_break.WATER, dam_break.AIR]
    mesh = Mesh(state["position"], state["cells"], state["fluid"])
    spacing = float(state["spacing"])
    density = np.array([f.density for f in fluids])
    particles = tp.Particles(
        position=state["position"],
        fluid=particle_fluid(mesh, len(mesh.position), density),
        wall=state["wall"],
        spacing=spacing,
        velocity=state["velocity"],
        acceleration=state["acceleration"],
        pressure=state["pressure"],
    )
    numerics = numerics or Numerics()
    width, height = dam_break.TANK
    corners = ((0, 0), (width, 0), (width, height), (0, height))
    ends = dict(
        zip(("bottom", "right", "top", "left"), zip(corners, (*corners[1:], corners[0]), strict=True), strict=True)
    )
    walls = [tp.Wall(name, between=points, law="layer") for name, points in ends.items()]
    case = tp.Case(particles, fluids, gravity=(0, -dam_break.GRAVITY), walls=walls, numerics=numerics)
    return tp.Simulation(case, time_step=largest_step(spacing))


def hard_systems(short: bool) -> dict[str, tuple[int, int]]:
    """Particles, and iterations of FGMRES to 1e-6, of first Newton systems that are hard for multigrid."""
    glycerin = tp.Fluid("glycerin", density=1261.0, viscosity=1.412)
    h, (width, height) = 0.015 if short else 0.005, dam_break.TANK
    layers = tp.tank(dam_break.TANK, h, jitter=0.1).fill(dam_break.WATER)
    layers.fill(glycerin, box=((0, height / 2), (width, height)))
    found = {"glycerin over water, steps of 10 ms": _iterations(layers, [dam_break.WATER, glycerin], 1e-2)}
    h = 1.0 / (60 if short else 234)
    bubbly = tp.tank((1.0, 1.0), h, jitter=0.1).fill(dam_break.WATER).fill(dam_break.AIR, box=((0, 0.85), (1, 1)))
    for k in range(26):
        bubbly.fill(dam_break.AIR, disc=((0.12 + 0.15 * (k % 6), 0.1 + 0.15 * (k // 6)), max(0.02, 1.6 * h)))
    both = [dam_break.WATER, dam_break.AIR]
    found["26 bubbles of air in water"] = _iterations(bubbly, both, 1e-3)
    for h, far in ((0.01, 0.08),) if short else ((0.005, 0.02), (0.002, 0.02), (0.002, 0.08)):
        column = tp.tank(dam_break.TANK, h).fill(dam_break.AIR).fill(dam_break.WATER, box=((0, 0), dam_break.COLUMN))
        found[f"dam break, graded from {h * 1e3:g} to {far * 1e3:g} mm"] = _iterations(
            column, both, 1e-3, tp.Grading({dam_break.AIR.name: far})
        )
    return found


def _iterations(tank: tp.Tank, fluids: list[tp.Fluid], dt: float, grading: tp.Grading | None = None) -> tuple[int, int]:
    particles = tank.sample(fluids, fitted=True, grading=grading)
    mesh = triangulate(particles.position, particles.wall, particles.spacing)
    mesh = with_fluids(mesh, particles, ranks(fluids))
    problem, x = first_system(mesh, particles, fluids, dt, Workspace())
    return len(particles), problem.correct(x, 1e-6).iterations


def first_system(
    mesh: Mesh,
    particles: tp.Particles,
    fluids: Sequence[tp.Fluid],
    dt: float,
    workspace: Workspace,
    jacobian: str = "rows",
) -> tuple[FlowProblem, Any]:
    """The problem of a time step under gravity, at its first iterate.

    Args:
        mesh: whose cells have fluids.
        particles: the state.
        fluids: of the case.
        dt: time step [s].
        workspace: arrays and grids that steps reuse.
        jacobian: "rows" or "matrix-free".

    Returns:
        The problem, whose residual has been evaluated, and the device vector of the first iterate.
    """
    density, viscosity = (np.array([getattr(fluid, name) for fluid in fluids]) for name in ("density", "viscosity"))
    material = ElementProperties(density[mesh.fluid], viscosity[mesh.fluid], np.zeros(len(mesh.cells)))
    force = np.tile([0.0, -dam_break.GRAVITY], (len(particles), 1))
    scheme, stabilisation = GeneralizedAlpha(0.0, dt), Numerics().stabilisation
    walls = WallTerm(WallsInStep(Boundary(particles, (), None), mesh, particles, scheme))
    given = mesh, particles, material, scheme, force, stabilisation, workspace
    problem = FlowProblem(*given, [walls], stores_rows=jacobian == "rows")
    x = problem.predict()
    problem.residual(x)
    return problem, x
