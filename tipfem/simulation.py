"""Simulation: the time step, and runs of it."""

from __future__ import annotations

import dataclasses
import math
import time as clock
from collections.abc import Callable, Mapping
from contextlib import closing, nullcontext, suppress
from pathlib import Path
from typing import Any

import numpy as np

from tipfem.arguments import is_number
from tipfem.backend import runtime
from tipfem.case.case import Case
from tipfem.case.particles import Particles
from tipfem.errors import SimulationError, StepRefused
from tipfem.fem.time_integration import GeneralizedAlpha, StepControl, smallest_jacobian
from tipfem.linalg.newton import NewtonResult, newton
from tipfem.mesh import probes
from tipfem.mesh.delaunay import TriangulationError
from tipfem.mesh.interface import INTERFACES
from tipfem.output import ResultsFolder, fill_columns, own_columns
from tipfem.progress import RunProgress
from tipfem.remesh.momentum_transfer import nodal_density, transfer_momentum
from tipfem.remesh.remeshers import Remeshed, remesher_for
from tipfem.step.budget import Budget, lumped
from tipfem.step.flow import ElementProperties, FlowProblem, Workspace
from tipfem.step.volume_source import VolumeControl
from tipfem.timers import Timings, timer
from tipfem.typing import Array
from tipfem.walls.motion import set_off
from tipfem.walls.step import WallStep, walls_in_step

Probe = Callable[["Simulation"], float]


class Simulation:
    """A case in motion.

    Args:
        case: what is simulated.
        out: folder for the results, or None to write none.
        time_step: largest time step [s]; by default 0.05 sqrt(h / |b|) with the largest acceleration b
            by gravity and body force at the start, or 1e-3 s without any.
        output_interval: time between fields written to disk by `run` [s]; steps are shortened to end at
            these times. By default only the first and the last state of a run.
        columns: further columns of the history, by name: functions of the simulation.

    Attributes:
        time: [s].
        particles: the present state; position, velocity, pressure, fluid, wall are NumPy arrays.
        mesh: simplices on the present positions.
        history: one dict a step, as in history.csv.
        timings: wall-clock seconds by part of a step; see `tipfem.timers`.

    Raises:
        ValueError: an argument is out of range, or ``out`` cannot be written to.
    """

    def __init__(
        self,
        case: Case,
        out: str | Path | None = None,
        *,
        time_step: float | None = None,
        output_interval: float | None = None,
        columns: Mapping[str, Probe] | None = None,
    ) -> None:
        for name, value in (("time step", time_step), ("output_interval", output_interval)):
            if value is not None and not (is_number(value) and value > 0):
                raise ValueError(f"Simulation: {name} is {value!r} s; it must be > 0")
        if not isinstance(case, Case):
            raise ValueError(f"Simulation: case is a {type(case).__name__}; it must be a Case")
        if output_interval is not None and time_step is not None and output_interval < 0.1 * time_step:
            raise ValueError(
                f"Simulation: output_interval is {output_interval:g} s, far below the time step of {time_step:g} s; "
                "every output shortens steps to end at it"
            )
        runtime.require_init()
        self.case, self.boundary = case, case.boundary
        self.output_interval = output_interval
        self.columns = own_columns(columns or {})
        self.time, self.step_number = 0.0, 0
        self.history: list[dict[str, float]] = []
        self.timings = Timings()
        self.interface = INTERFACES[case.interface]()
        frequency = case.natural_frequency()
        largest = time_step or (0.05 / frequency if frequency else 1e-3)
        self.control = StepControl(largest, target=case.numerics.largest_move)
        self.budget, self._workspace = Budget(case), Workspace()
        self._walls: WallStep | None = None
        self._nodal_density: Array | None = None  # around each particle, where no fluid is known of elements
        self._reference = case.pressure_reference()
        self.remesher = remesher_for(case, self._reference)
        self._started, self._outputs = clock.perf_counter(), 0
        try:
            initial = set_off(case.boundary, case.particles.copy(), 0.25 * self.control.largest)
            self._take(self.remesher.start(initial))
        except TriangulationError as error:
            raise ValueError(f"Simulation: the initial particles cannot be meshed: {error}") from error
        # With a sharp interface the remesher keeps the volumes, and without jumps of pressure.
        rate = 0.0 if case.interface == "sharp" else case.numerics.volume_correction * frequency
        self.volume_control = VolumeControl(self.budget.totals().volume, rate, balanced=case.closed)
        # Last of all: it removes what an earlier run left, which a refused simulation must not do.
        self.results = ResultsFolder(out) if out is not None else None
        if self.results:
            self.results.write_case(case)

    def step(self, until: float = math.inf) -> None:
        """Advance by one accepted time step: solve, accept, relocate, mesh.

        Args:
            until: time that must not be stepped over [s].

        Raises:
            ValueError: ``until`` is not later than the present time.
            SimulationError: even the smallest time step was refused; or the step was accepted, but a
                function in ``columns`` failed, and its value in the history is NaN.
        """
        if not until > self.time:
            raise ValueError(f"step: until is {until!r} s; it must be later than the present {self.time:g} s")
        with self.timings.active(), timer("step"):
            self._step(until)

    def _step(self, until: float) -> None:
        while True:
            pace = self.boundary.speed_over_spacing(self.particles, self.time, self.control.current)
            dt = self.control.length(pace, until - self.time, lambda s: smallest_jacobian(self.mesh, self.particles, s))
            try:
                moved, result = self._solve(dt)
                with timer("remeshing"):
                    remeshed = self.remesher.remesh(moved, self.mesh, self._walls)
                self._take(remeshed, self._nodal_density)
                break
            except (StepRefused, TriangulationError, FloatingPointError) as reason:
                if not self.control.refuse(dt):
                    raise SimulationError(
                        f"the run stops at t = {self.time:.6g} s, step {self.step_number}: {reason}; "
                        f"halving the time step down to {dt:.3g} s did not help"
                    ) from reason
        self.control.accept(dt)
        self.volume_control.observe(self.budget.totals().volume, dt)
        self.time = until if abs(until - self.time - dt) < 1e-9 * dt else self.time + dt
        self.step_number += 1
        self._record(dt, result, remeshed.number)

    def run(self, until: float, *, progress: bool = True) -> None:
        """Step until a time, writing history and fields on the way.

        Args:
            until: [s].
            progress: show a progress bar when the error output is a terminal.

        Raises:
            ValueError: the time has passed already.
            SimulationError: the run cannot go on; all up to there is on disk.
        """
        if not until > self.time:
            raise ValueError(f"run: until is {until!r} s; it must be later than the present {self.time:g} s")
        if self.step_number == 0 or self.time >= self._next_output():  # the latter after calls of `step`
            self._write_fields()
        bar = RunProgress(self.time, until, enabled=progress)
        status = "stopped"
        try:
            with bar, closing(self.results) if self.results else nullcontext():
                while self.time < until:
                    self.step(min(until, self._next_output()))
                    bar.update(self.time, self.history[-1])
                    if self.time >= self._next_output() or self.time >= until:
                        self._write_fields()
            status = "complete"
        except KeyboardInterrupt:
            status = "interrupted"
            raise
        except SimulationError as error:
            status = str(error)
            raise
        except OSError as error:
            raise SimulationError(f"the results cannot be written at t = {self.time:.6g} s: {error}") from error
        finally:
            # On a disk that is full neither can be written; what stopped the run is the better message.
            with nullcontext() if status == "complete" else suppress(OSError):
                if status != "complete":
                    self._write_fields()
                self.write_summary({"status": status})

    @timer("solve")
    def _solve(self, dt: float) -> tuple[Particles, NewtonResult]:
        """The state after a step of length ``dt``, before relocation.

        Raises:
            StepRefused: Newton's method failed, an element would invert, or a particle would move too far.
        """
        numerics = self.case.numerics
        scheme = GeneralizedAlpha(numerics.rho_inf, dt)
        position, varies = self.particles.position, self.case.body_force is not None
        position = position + scheme.cf * scheme.predict(self.particles) if varies else position
        force = self.case.acceleration(position, self.time + scheme.cf * dt)
        before, source = self.particles, self.volume_control.source(self.mesh, self._fraction, dt)
        material = ElementProperties(self._density, self._viscosity, source)
        self._walls = walls_in_step(self.boundary, self.mesh, before, material.viscosity, scheme, self.time)
        problem = FlowProblem(
            self.mesh, before, material, scheme, force, numerics.stabilisation, self._workspace, self._walls
        )
        forces = force if varies else force[:1]
        tolerance = numerics.tolerance(forces, scheme.cm, before.spacing, runtime.round_off())
        if self.step_number == 0:  # what the first step leaves of pressure's error would slosh for long
            tolerance = min(tolerance, 10 * runtime.round_off())
        result = newton(
            problem,
            problem.predict(),
            tolerance=tolerance,
            max_iterations=numerics.newton_iterations,
            noise=runtime.round_off(),
        )
        result.require()
        limits = problem.limits(result.solution)
        limits.require(numerics.smallest_jacobian, self.control.reach)
        displacement, pressure = problem.split(result.solution)
        if self.mesh.surface is None or not self.mesh.surface.front.any():
            pressure -= pressure[self._reference]
        after = scheme.advance(before, displacement, pressure)
        after = self._walls.finish(before, displacement, after) if self._walls else after
        after = self.mesh.surface.landed(before, after, force, dt) if self.mesh.surface else after
        with timer("budget"):
            self.budget.solved(problem, result.solution, displacement, after, force)
        return after, result

    @timer("state")
    def _take(self, remeshed: Remeshed, before: Array | None = None) -> None:
        """Make particles on a new mesh the present state; before (N,) is the density around each on the old mesh."""
        particles, mesh, relocated, _number, renumbered = remeshed
        if renumbered is not None:
            self._reference = int(renumbered[self._reference])
        fluid, fluids = particles.fluid, self.case.fluids
        density, viscosity = self.interface.element_properties(mesh, fluid, fluids)
        mass = lumped(mesh, density)
        if mesh.fluid is None:  # with one, no particle changes its weight much with the mesh
            self._nodal_density = around = nodal_density(mass, lumped(mesh, np.ones(len(density))))
            if before is not None and self.case.numerics.momentum_transfer:
                before = np.where(relocated, np.nan, before)
                particles = transfer_momentum(particles, mesh, before, around, self.boundary.still)
        if self._walls and mesh.fluid is not None:
            self.boundary = self._walls.reassign(particles)
        elif self._walls:
            particles = self._walls.impose(particles)
        self.mesh, self.particles, self._density, self._viscosity = mesh, particles, density, viscosity
        self._fraction = None if mesh.fluid is not None else self.interface.fluid_fraction(mesh, fluid, len(fluids))
        self.budget.remeshed(mesh, particles, mass, self._fraction)

    def volume(self, name: str) -> float:
        """Volume of a fluid [m^2 in 2-D, m^3 in 3-D], spray included; see `Case.fluid_index` for errors."""
        return float(self.budget.totals().volume[self.case.fluid_index(name)])

    def energy(self) -> probes.Energy:
        """Kinetic and potential energy [J, per metre of depth in 2-D]."""
        return probes.Energy(self.budget.totals().kinetic, self.budget.totals().potential)

    def write_summary(self, content: Mapping[str, Any] | None = None) -> None:
        """Write summary.json with the run's settings and ``content``; nothing without a results folder."""
        if not self.results:
            return
        self.results.write_summary(
            {
                "time": self.time,
                "steps": self.step_number,
                "wall_seconds": clock.perf_counter() - self._started,
                "particles": len(self.particles),
                "spacing": self.particles.spacing,
                "grading": self.case.grading.summary() if self.case.grading else None,
                "largest_time_step": self.control.largest,
                **runtime.settings(),
                "interface": self.case.interface,
                "numerics": dataclasses.asdict(self.case.numerics),
                "fluids": [vars(f) for f in self.case.fluids],
                **(content or {}),
            }
        )

    @timer("history")
    def _record(self, dt: float, result: NewtonResult, relocated: int) -> None:
        """Add the step to the history, in memory and on disk."""
        row: dict[str, float] = {
            "step": self.step_number,
            "time": self.time,
            "time_step": dt,
            "particles": len(self.particles),
            "newton_iterations": result.iterations,
            "krylov_iterations": result.krylov_iterations,
            "relocated": relocated,
            "rebuilt": self.remesher.rebuilt,
            "max_speed": self.particles.max_speed,
            **self.budget.row(),
        }
        row.update(dict.fromkeys(self.columns, math.nan), wall_seconds=clock.perf_counter() - self._started)
        try:
            failure = fill_columns(row, self.columns, self)
        finally:  # also when interrupted: an accepted step has its row
            self.history.append(row)
            if self.results:
                self.results.append_history(row)
        if failure:
            raise SimulationError(f"t = {self.time:.6g} s, step {self.step_number}: {failure}") from failure.__cause__

    def _next_output(self) -> float:
        return math.inf if self.output_interval is None else self._outputs * self.output_interval

    def _write_fields(self) -> None:
        """Write the present state to disk, and set when the next one is due."""
        if self.output_interval is not None:
            self._outputs = math.floor(self.time / self.output_interval + 1e-9) + 1
        if self.results:
            density = np.array([f.density for f in self.case.fluids])[self.particles.fluid]
            with self.timings.active(), timer("output"):
                self.results.write_fields(self.step_number, self.time, self.mesh, self.particles, density)
