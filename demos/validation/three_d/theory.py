"""Waves in a box with walls that slip, by linear theory with viscosity.

On one fluid of depth H the surface eta = cos(a x) cos(b y) e^(n t), k^2 = a^2 + b^2, moves by the potential
A cosh(k (z + H)) and a rotational part of the vertical velocity k B sinh(m (z + H)), m^2 = k^2 + n / nu. That no shear
and no pressure act on the surface gives

    (n + 2 nu k^2)^2 + g k tanh(k H) - 4 nu^2 k^3 m tanh(k H) / tanh(m H) = 0

which on deep water is that of H. Lamb, Hydrodynamics, 6th ed., 1932, section 349. An interface between a heavy fluid
above and a light one, both deep and of the kinematic viscosity nu, leaves its level at the rate n with

    -(g k (a_1 - a_2) / n^2 + 1) (q - k) - 4 k a_1 a_2 - 4 k^2 nu / n (a_1 - a_2)^2 (q - k - k nu / n (q - k)^2) = 0

with q^2 = k^2 + n / nu and a_1, a_2 the densities below and above over their sum: S. Chandrasekhar, Hydrodynamic and
Hydromagnetic Stability, 1961, section 94.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Wave:
    """A standing wave of one fluid in a box.

    Attributes:
        size: length, width of the box, and depth of the fluid [m].
        halves: half waves along its length and its width.
        viscosity: kinematic [m^2/s].
        gravity: [m/s^2].
    """

    size: tuple[float, float, float]
    halves: tuple[int, int]
    viscosity: float
    gravity: float

    @property
    def numbers(self) -> Array:
        """Wave numbers along length and width [1/m]."""
        return np.pi * np.asarray(self.halves) / self.size[:2]

    @property
    def k(self) -> float:
        """Wave number [1/m]."""
        return float(np.hypot(*self.numbers))

    def rate(self) -> complex:
        """Rate n of the normal mode [1/s]: minus its damping, and its frequency."""
        k, nu, depth = self.k, self.viscosity, self.size[2]
        square = self.gravity * k * math.tanh(k * depth)
        n = complex(0, math.sqrt(square))
        for _ in range(100):
            m = cmath.sqrt(k * k + n / nu)
            shear = 4 * nu**2 * k**3 * m * math.tanh(k * depth) / cmath.tanh(m * depth)
            n = cmath.sqrt(shear - square) - 2 * nu * k * k
            n = n if n.imag > 0 else -n - 4 * nu * k * k
        return n

    def shape(self, x: Array) -> Array:
        """The mode at places (K, 3)."""
        return np.asarray(np.cos(x[:, :2] * self.numbers).prod(axis=1))

    def velocity(self, x: Array, amplitude: float) -> Array:
        """Velocities (K, 3) [m/s] at places (K, 3) [m] when the level is even, of a wave of an amplitude [m]."""
        k, n, depth = self.k, self.rate(), self.size[2]
        m = cmath.sqrt(k * k + n / self.viscosity)
        # By unit of the potential part of the vertical velocity at the surface.
        swirl = -2 * k * k / (m * m + k * k)
        z = np.minimum(x[:, 2], depth)

        def hyperbolic(f: complex, sign: int) -> Array:
            """Of f z over sinh(f H)."""
            up, down = np.exp(f * (z - depth)), np.exp(-f * (z + depth))
            return np.asarray((up + sign * down) / (1 - cmath.exp(-2 * f * depth)))

        # n eta = w at the surface; the phase is that in which eta = 0.
        unit = 1j * amplitude * n / (1 + swirl)
        upward = np.real(unit * (hyperbolic(k, -1) + swirl * hyperbolic(m, -1)))
        along = np.real(unit * (hyperbolic(k, 1) + swirl * m / k * hyperbolic(m, 1))) / k
        a, b = self.numbers
        slope_x = -a * np.sin(a * x[:, 0]) * np.cos(b * x[:, 1])
        slope_y = -b * np.cos(a * x[:, 0]) * np.sin(b * x[:, 1])
        return np.stack([along * slope_x, along * slope_y, upward * self.shape(x)], axis=1)


def overturning(k: float, atwood: float, viscosity: float, gravity: float) -> float:
    """Rate at which an interface with the heavy fluid above leaves its level [1/s]."""
    upper, lower = 0.5 * (1 + atwood), 0.5 * (1 - atwood)  # densities over their sum
    jump = lower - upper

    def off(n: float) -> float:
        more, taken = math.sqrt(k * k + n / viscosity) - k, 4 * k * k * viscosity / n * jump**2
        driven = -(gravity * k / n**2 * jump + 1) * more - 4 * k * lower * upper
        return driven - taken * more + taken * k * viscosity / n * more**2

    return float(brentq(off, 1e-6 * math.sqrt(gravity * k), math.sqrt(gravity * k)))
