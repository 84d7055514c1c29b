"""A standing wave of finite amplitude without viscosity, by the high-order spectral method.

D. G. Dommermuth, D. K. P. Yue, A high-order spectral method for the study of nonlinear gravity waves, J. Fluid Mech.
184, 1987; B. J. West et al., A new numerical method for surface hydrodynamics, J. Geophys. Res. 92, 1987. One fluid,
whose surface elevation eta(x, t) and potential there phi(x, t) are sums of cosines between two walls:

    eta_t = (1 + eta_x^2) W - phi_x eta_x
    phi_t = -g eta - phi_x^2 / 2 + (1 + eta_x^2) W^2 / 2

with the vertical velocity W at the surface expanded in powers of eta. A light fluid above changes a wave of water by
its density over that of water.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ORDER = 5  # of the expansion in the surface's slope
POINTS = 64  # on two lengths of the tank
STEPS = 200  # a period


class StandingWave:
    """A wave in a tank with vertical walls.

    Args:
        length: of the tank, half a wavelength [m].
        depth: of the fluid [m].
        gravity: [m/s^2].
    """

    def __init__(self, length: float, depth: float, gravity: float) -> None:
        self.length, self.depth, self.gravity = length, depth, gravity
        self.x = np.arange(POINTS) * 2 * length / POINTS
        number = np.fft.fftfreq(POINTS, 1 / POINTS)
        self._k, self._kept = number * math.pi / length, np.abs(number) <= POINTS // (ORDER + 1)

    def course(self, amplitude: float, duration: float) -> Array:
        """Times [s] and amplitudes of the first mode over that of the start (K, 2).

        Args:
            amplitude: of the cosine in which the surface is at rest at the start [m].
            duration: [s].
        """
        k = math.pi / self.length
        dt = 2 * math.pi / math.sqrt(self.gravity * k * math.tanh(k * self.depth)) / STEPS
        mode = np.cos(k * self.x)
        state = np.array([amplitude * mode, 0 * mode])
        found = [(0.0, 1.0)]
        while found[-1][0] < duration:  # Runge & Kutta's method of order 4
            one = self._rates(state)
            two = self._rates(state + 0.5 * dt * one)
            three = self._rates(state + 0.5 * dt * two)
            four = self._rates(state + dt * three)
            state = state + dt / 6 * (one + 2 * two + 2 * three + four)
            found.append((found[-1][0] + dt, state[0] @ mode * 2 / POINTS / amplitude))
        return np.array(found)

    def _filtered(self, f: Array, factor: Array | complex = 1.0) -> Array:
        return np.asarray(np.fft.ifft(np.fft.fft(f) * factor * self._kept).real)

    def _vertical(self, f: Array, times: int) -> Array:
        """The vertical derivative at z = 0, so many times, of the potential that is f there."""
        k = np.abs(self._k)
        return np.asarray(np.fft.ifft(np.fft.fft(f) * k**times * (np.tanh(k * self.depth) if times % 2 else 1.0)).real)

    def _rates(self, state: Array) -> Array:
        eta, phi = state
        powers = [eta**m / math.factorial(m) for m in range(ORDER)]
        terms = [phi]
        for m in range(1, ORDER):
            terms.append(-self._filtered(sum(powers[n] * self._vertical(terms[m - n], n) for n in range(1, m + 1))))
        w = sum(powers[n] * self._vertical(terms[m - n], n + 1) for m in range(ORDER) for n in range(m + 1))
        w = self._filtered(np.asarray(w))
        slope, along = (self._filtered(f, 1j * self._k) for f in (eta, phi))
        rise = (1 + slope**2) * w - along * slope
        push = -self.gravity * eta - 0.5 * along**2 + 0.5 * (1 + slope**2) * w**2
        return np.array([self._filtered(rise), self._filtered(push)])
