"""A flow known in closed form: one vortex in the unit square, no-slip walls, kept up by a body force.

psi = sin^2(pi x) sin^2(pi y) / pi,  u = (d psi / dy, -d psi / dx) g(t),  p = cos(pi x) cos(pi y) g(t),
b = Du/Dt + grad p / rho - nu lap u,  with rho = 1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

PI = np.pi


@dataclass(frozen=True)
class Vortex:
    """The flow for a viscosity nu [m^2/s] and an amplitude g(t) with its derivative."""

    viscosity: float
    amplitude: Callable[[float], float] = lambda t: 1.0
    rate: Callable[[float], float] = lambda t: 0.0

    def shape(self, x: np.ndarray) -> np.ndarray:
        """Velocity (K, 2) at amplitude 1."""
        sx, sy = np.sin(PI * x).T
        cx, cy = np.cos(PI * x).T
        return np.stack([2 * sx**2 * sy * cy, -2 * sx * cx * sy**2], axis=1)

    def convection(self, x: np.ndarray) -> np.ndarray:
        """(u . grad) u (K, 2) at amplitude 1."""
        s2x, s2y = np.sin(2 * PI * x).T
        c2x, c2y = np.cos(2 * PI * x).T
        qx, qy = (np.sin(PI * x) ** 2).T
        u, v = self.shape(x).T
        return np.stack(
            [u * PI * s2x * s2y + v * 2 * PI * qx * c2y, -u * 2 * PI * c2x * qy - v * PI * s2x * s2y], axis=1
        )

    def pressure_and_viscous(self, x: np.ndarray) -> np.ndarray:
        """grad p - nu lap u (K, 2) at amplitude 1."""
        s2x, s2y = np.sin(2 * PI * x).T
        c2x, c2y = np.cos(2 * PI * x).T
        qx, qy = (np.sin(PI * x) ** 2).T
        sx, sy = np.sin(PI * x).T
        cx, cy = np.cos(PI * x).T
        laplacian = np.stack(
            [
                2 * PI**2 * c2x * s2y - 4 * PI**2 * qx * s2y,
                4 * PI**2 * s2x * qy - 2 * PI**2 * s2x * c2y,
            ],
            axis=1,
        )
        return np.stack([-PI * sx * cy, -PI * cx * sy], axis=1) - self.viscosity * laplacian

    def velocity(self, x: np.ndarray, t: float) -> np.ndarray:
        """Velocity (K, 2) [m/s]."""
        return self.amplitude(t) * self.shape(x)

    def acceleration(self, x: np.ndarray, t: float) -> np.ndarray:
        """Material derivative of the velocity (K, 2) [m/s^2]."""
        return self.rate(t) * self.shape(x) + self.amplitude(t) ** 2 * self.convection(x)

    def body_force(self, x: np.ndarray, t: float) -> np.ndarray:
        """The force per mass (K, 2) [m/s^2] that keeps the flow up."""
        return self.acceleration(x, t) + self.amplitude(t) * self.pressure_and_viscous(x)
