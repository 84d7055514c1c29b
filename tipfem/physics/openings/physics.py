"""Openings: inlets, outlets and vents of a case, in its steps and between them."""

from __future__ import annotations

import dataclasses

import numpy as np

from tipfem.case.boundary.boundary import Boundary
from tipfem.case.case import Case
from tipfem.case.particles import Particles
from tipfem.mesh.mesh import Mesh
from tipfem.physics.openings.lines import OpeningLines
from tipfem.physics.openings.passed import Passed
from tipfem.physics.openings.put_back import Gate
from tipfem.physics.openings.term import OpeningTerm
from tipfem.physics.physics import Entered, Moved, Physics, StepStart
from tipfem.typing import Array


class Openings(Physics[Passed]):
    """See the module; they carry what has passed."""

    name = "openings"
    open = True

    def __init__(self, case: Case) -> None:
        self._openings = OpeningLines(case)
        self._gate, self._boundary = Gate(self._openings, case), case.boundary
        names = [line.opening.name for line in self._openings.lines]
        self.columns = tuple(f"through_{name}_{fluid}" for name in names for fluid in self._openings.names)

    @classmethod
    def of(cls, case: Case) -> Openings | None:
        """See `Physics.of`."""
        return cls(case) if case.openings else None

    def start(self, particles: Particles, step: float) -> Passed:
        """See `Physics.start`; a function of time that gives no speeds is refused here."""
        assert self._boundary.passages is not None
        for line, on in zip(self._openings.lines, self._boundary.passages.nodes, strict=True):
            if line.opening.velocities:
                line.speeds(particles.position[on], 0.0)
        return Passed.nothing(len(self._openings.lines), len(self._openings.names))

    def terms(self, part: Passed, step: StepStart) -> tuple[OpeningTerm]:
        """See `Physics.terms`."""
        given = step.walls, step.particles, step.mesh, step.scheme, step.time
        return (OpeningTerm(self._openings, *given, part),)

    def flooded(self, part: Passed, mesh: Mesh, boundary: Boundary, position: Array, until: float) -> Mesh:
        """See `Physics.flooded`: cells at inlets are of the fluids that enter; empty ones only where they soon do."""
        assert boundary.passages is not None
        setting, nodes, speeds = self._openings.setting(part, until), boundary.passages.nodes, list[Array | None]()
        for k, (line, on) in enumerate(zip(setting.lines, nodes, strict=True)):
            given = setting.speeds(k, position[on], until) if line.opening.velocities else np.zeros(len(on))
            speeds.append(given if (given > 0).any() or setting.reservoir(k) else None)
        fluid = self._gate.flooded(mesh, nodes, position, until, speeds)[0]
        return mesh if (fluid == mesh.fluid).all() else mesh.relabelled(fluid)

    def before_repair(self, part: Passed, moved: Moved) -> tuple[Passed, Moved]:
        """See `Physics.before_repair`: the particles of openings are put back."""
        assert moved.boundary.passages is not None
        done = self._gate.put_back(moved, moved.boundary.passages.nodes, part)
        through = moved.particles.position, done.particles.position
        now = dataclasses.replace(moved, particles=done.particles, mesh=done.mesh, left=done.left, through=through)
        return done.passed, now

    def imposed(self, part: Passed, particles: Particles, boundary: Boundary, time: float, step: float) -> Particles:
        """See `Physics.imposed`."""
        assert boundary.passages is not None
        return self._openings.imposed(particles, boundary.passages, time, step, part)

    def entered(self, part: Passed) -> Entered:
        """See `Physics.entered`."""
        return Entered(part.volume.sum(axis=0), part.energy_in, part.momentum_in)

    def row(self, part: Passed, particles: Particles) -> dict[str, float]:
        """See `Physics.row`: the volume of each fluid that has entered by each opening in the step [m^2]."""
        return dict(zip(self.columns, part.volume.ravel().tolist(), strict=True))
