"""Openings of a case in a step: what they prescribe at the particles on them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tipfem.case.case import Case
from tipfem.case.openings import Inlet, OpenLine, Outlet
from tipfem.case.particles import Particles
from tipfem.case.passages import Passages
from tipfem.mesh.mesh import Mesh
from tipfem.typing import Array


@dataclass(frozen=True)
class Rates:
    """What inlets prescribe in a step, at K particles.

    Attributes:
        particles: (K,).
        displacement: (K, 2) [m].
        velocity, acceleration: (2, K, 2) at its start and at its end [m/s, m/s^2].
    """

    particles: Array
    displacement: Array
    velocity: Array
    acceleration: Array


class Openings:
    """The openings of a case.

    Args:
        case: with openings.

    Attributes:
        lines: of the openings.
        names: of the fluids.
        density: (F,) of the fluids [kg/m^3].
    """

    def __init__(self, case: Case) -> None:
        self.lines = case.boundary.lines
        self.names = [fluid.name for fluid in case.fluids]
        self.density = np.array([fluid.density for fluid in case.fluids], dtype=float)
        self._gravity = np.asarray(case.gravity, dtype=float)
        self._lightest = int(np.argmin(self.density))

    def prescribed(self, nodes: list[Array], position: Array, time: float, dt: float) -> Rates:
        """What inlets prescribe in a step.

        Args:
            nodes: the particles of each opening, see `tipfem.case.passages.Passages`.
            position: (N, 2) of the particles at the step's start [m].
            time: there [s].
            dt: length of the step [s].
        """
        parts = [(np.zeros(0, dtype=np.int64), np.zeros((5, 0, 2)))]
        for line, on in zip(self.lines, nodes, strict=True):
            if not line.opening.velocities:
                continue
            x, step = position[on], 0.25 * dt
            values = [
                line.displacements(x, time, time + dt),
                *line.rates(x, time, step),
                *line.rates(x, time + dt, step),
            ]
            parts.append((on, np.stack(values)[:, :, None] * line.inwards))
        particles, vectors = np.concatenate([p for p, _ in parts]), np.concatenate([v for _, v in parts], axis=1)
        return Rates(particles, vectors[0], vectors[[1, 3]], vectors[[2, 4]])

    def imposed(self, particles: Particles, passages: Passages, time: float, step: float) -> Particles:
        """The particles with what openings prescribe at a time.

        Args:
            particles: any.
            passages: those of openings among them.
            time: [s].
            step: of finite differences [s].
        """
        done = particles.shallow_copy(velocity=particles.velocity.copy(), acceleration=particles.acceleration.copy())
        crossing, across = passages.crossing, passages.across
        for values in (done.velocity, done.acceleration):
            values[crossing] = np.einsum("ki,ki->k", values[crossing], across)[:, None] * across
        for line, on in zip(self.lines, passages.nodes, strict=True):
            if line.opening.velocities:
                v, rate = line.rates(particles.position[on], time, step)
                done.velocity[on], done.acceleration[on] = v[:, None] * line.inwards, rate[:, None] * line.inwards
        return done

    def tractions(self, nodes: list[Array], particles: Particles, mesh: Mesh, time: float, moved: Array) -> Array:
        """(N, 2) forces of the pressures that are given at openings on the particles there [N/m].

        What flows in comes from fluid at rest: on the edges where it does, the pressure is less by rho v^2 / 2.

        Args:
            nodes: the particles of each opening.
            particles: at the step's start.
            mesh: of them.
            time: at which pressures are given [s].
            moved: (N, 2) by how much the particles will have left the line by then [m]. There the pressure differs from
                that given by the weight of the fluid between.
        """
        result = np.zeros_like(particles.position)
        for line, on in zip(self.lines, nodes, strict=True):
            outlet = line.opening
            if not isinstance(outlet, Outlet):
                continue
            x = particles.position[on]
            density = self.density[edge_fluids(mesh, on)]
            ends, middle = self._pressures(outlet, x, density, time)
            beyond = (moved[on] @ line.inwards) * float(line.inwards @ self._gravity)
            weight = 0.5 * density * (beyond[1:] + beyond[:-1])
            v = np.maximum(particles.velocity[on] @ line.inwards, 0.0)
            head = 0.5 * density * (0.5 * (v[1:] + v[:-1])) ** 2
            # Simpson's rule on each edge: exact for pressures that are quadratic in place.
            length = np.diff(line.coordinates(x)) / 6
            force = np.zeros(len(on))
            force[:-1] += length * (ends[:-1] + density * beyond[:-1] + 2 * (middle + weight) - 3 * head)
            force[1:] += length * (ends[1:] + density * beyond[1:] + 2 * (middle + weight) - 3 * head)
            result[on] += force[:, None] * line.inwards
        return result

    def _pressures(self, outlet: Outlet, x: Array, density: Array, time: float) -> tuple[Array, Array]:
        """Pressures (K,) at the particles (K, 2) of an outlet, and (K - 1,) in the middle of its edges [Pa]."""
        between = 0.5 * (x[1:] + x[:-1])
        if outlet.pressure == "hydrostatic":
            # From the weight of what stands there, edge by edge, 0 at the upper end.
            p = np.append(0.0, np.cumsum(density * (np.diff(x, axis=0) @ self._gravity)))
            if (x[-1] - x[0]) @ self._gravity < 0:
                p = p - p[-1]
            return p, 0.5 * (p[1:] + p[:-1])
        if outlet.level is None:
            return outlet.pressure_at(x, time), outlet.pressure_at(between, time)
        strength = float(np.linalg.norm(self._gravity))
        up = -self._gravity / strength if strength else np.zeros(2)
        top, level = float((x @ up).max()), outlet.level_at(time)
        below, above = self.density[outlet.level_fluid(self.names)], self.density[self._lightest]

        def at(place: Array) -> Array:
            height = place @ up
            light = above * (top - np.maximum(height, min(level, top)))
            return np.asarray(strength * (light + below * np.maximum(level - height, 0.0)))

        return at(x), at(between)

    def fluids_in(self, line: OpenLine, x: Array, time: float) -> Array:
        """Numbers (K,) of the fluids that enter by an inlet at places (K, 2) near its line [m]."""
        assert isinstance(line.opening, Inlet)
        return line.opening.entering(line.a + line.coordinates(x)[:, None] * line.along, time, self.names)


def edge_fluids(mesh: Mesh, on: Array) -> Array:
    """Numbers (K - 1,) of the fluids of the cells between the K particles of an opening, one after the other."""
    assert mesh.fluid is not None
    cell, k = np.nonzero(mesh.neighbours < 0)
    start = mesh.cells[cell, (k + 1) % 3]
    # The cell of each face of the hull, by the particle where it begins: the fluid is on the left.
    at = np.full(len(mesh.position), -1, dtype=np.int64)
    at[start] = cell
    return mesh.fluid[at[on[:-1]]]
