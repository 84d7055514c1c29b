"""Linear stability of two viscous fluids that slide over each other between walls that slip, by Chebyshev collocation.

The lower fluid fills -H < y < 0, the upper one 0 < y < H; both have the viscosity mu, and a body force keeps the flow
U(y) steady, with U''(0) = 0. A perturbation u' = phi'(y) e^{ik(x - ct)}, v' = -i k phi e^{ik(x - ct)} obeys in each
fluid

    rho (U - c) (phi'' - k^2 phi) - rho U'' phi = mu / (i k) (phi'''' - 2 k^2 phi'' + k^4 phi)

(Orr and Sommerfeld). At the interface, of height eta e^{ik(x - ct)} with phi = (c - U) eta, phi, phi' and the shear
stress, hence phi'', are continuous, and so is the normal stress: rho ((U - c) phi' - U' phi) - mu / (i k) phi''' jumps
by ((rho_lower - rho_upper) g + sigma k^2) eta from below. At the walls phi = phi'' = 0. L. N. Trefethen, Spectral
Methods in MATLAB, SIAM, 2000.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BarycentricInterpolator
from scipy.linalg import eig

Array = NDArray[np.float64]
Profile = Callable[[Array], Array]

POINTS = 60  # intervals in each fluid


@dataclass(frozen=True)
class Shear:
    """A steady flow of two fluids.

    Attributes:
        height: H [m], of each fluid.
        density: of the lower and of the upper fluid [kg/m^3].
        viscosity: mu of both [Pa s].
        velocity, slope, curvature: U, U' and U'' as functions of y.
        gravity: g [m/s^2].
        tension: sigma of the interface [N/m].
    """

    height: float
    density: tuple[float, float]
    viscosity: float
    velocity: Profile
    slope: Profile
    curvature: Profile
    gravity: float = 0.0
    tension: float = 0.0


@dataclass(frozen=True)
class Mode:
    """The fastest growing perturbation of a wave number, for an interface of height Re e^{ikx} at t = 0.

    Attributes:
        wave_number: k [1/m].
        speed: c, complex [m/s]; it grows at the rate k Im c.
        stream: phi and phi' of the lower and of the upper fluid, as functions of y.
    """

    wave_number: float
    speed: complex
    stream: tuple[tuple[Callable[[Array], Array], Callable[[Array], Array]], ...]

    @property
    def growth(self) -> float:
        """Rate of growth [1/s]."""
        return float(self.wave_number * self.speed.imag)

    def velocity(self, layer: int, x: Array, y: Array) -> Array:
        """(K, 2) velocities [m/s] at the start in the lower (0) or upper (1) fluid, for an amplitude of 1 m."""
        phi, slope = self.stream[layer]
        wave = np.exp(1j * self.wave_number * x)
        return np.stack([(slope(y) * wave).real, (-1j * self.wave_number * phi(y) * wave).real], axis=1)


def fastest(shear: Shear, k: float) -> Mode:
    """The mode of the wave number ``k`` [1/m] that grows fastest."""
    grid, d1 = _chebyshev(POINTS)
    count, high = POINTS + 1, shear.height
    d1 = 2 / high * d1
    d2 = d1 @ d1
    d3, one = d2 @ d1, np.eye(count)
    y = (grid - 1) * high / 2, (grid + 1) * high / 2
    a = np.zeros((2 * count + 1, 2 * count + 1), dtype=complex)
    b = np.zeros_like(a)
    for layer, rho in enumerate(shear.density):
        own = slice(layer * count, (layer + 1) * count)
        laplacian = d2 - k**2 * one
        a[own, own] = rho * (shear.velocity(y[layer])[:, None] * laplacian - np.diag(shear.curvature(y[layer])))
        a[own, own] -= shear.viscosity / (1j * k) * laplacian @ laplacian
        b[own, own] = rho * laplacian

    def value(layer: int, matrix: Array, point: int) -> NDArray[np.complex128]:
        row = np.zeros(2 * count + 1, dtype=complex)
        row[layer * count : (layer + 1) * count] = matrix[point]
        return row

    # The points run downwards: the first of the lower fluid and the last of the upper one are on the interface.
    last = count - 1
    zero = np.zeros(1)
    u, slope = float(shear.velocity(zero)[0]), float(shear.slope(zero)[0])
    stress, stress_c = np.zeros(2 * count + 1, dtype=complex), np.zeros(2 * count + 1, dtype=complex)
    for layer, point, sign in ((0, 0, 1), (1, last, -1)):
        rho, d = shear.density[layer], value(layer, d1, point)
        stress += sign * rho * (u * d - slope * value(layer, one, point))
        stress -= sign * shear.viscosity / (1j * k) * value(layer, d3, point)
        stress_c += sign * rho * d
    stress[-1] = (shear.density[0] - shear.density[1]) * shear.gravity + shear.tension * k**2
    moves, moves_c = value(0, one, 0), np.zeros(2 * count + 1, dtype=complex)
    moves[-1], moves_c[-1] = u, 1.0
    nothing = np.zeros(2 * count + 1, dtype=complex)
    for row, left, right in (
        (last, value(0, one, last), nothing),  # walls
        (last - 1, value(0, d2, last), nothing),
        (count, value(1, one, 0), nothing),
        (count + 1, value(1, d2, 0), nothing),
        (0, value(0, one, 0) - value(1, one, last), nothing),  # interface
        (1, value(0, d1, 0) - value(1, d1, last), nothing),
        (2 * count - 1, value(0, d2, 0) - value(1, d2, last), nothing),
        (2 * count - 2, stress, stress_c),
        (2 * count, moves, moves_c),
    ):
        a[row], b[row] = left, right
    speeds, vectors = eig(a, b)
    fast = 50 * np.abs(shear.velocity(np.linspace(-high, high, 11))).max()
    spurious = ~np.isfinite(speeds) | (np.abs(speeds) > fast)
    chosen = int(np.argmax(np.where(spurious, -np.inf, speeds.imag)))
    phi = vectors[:, chosen] / vectors[-1, chosen]
    parts = [phi[:count], phi[count : 2 * count]]
    stream = tuple(
        (BarycentricInterpolator(y[layer], part), BarycentricInterpolator(y[layer], d1 @ part))
        for layer, part in enumerate(parts)
    )
    return Mode(k, complex(speeds[chosen]), stream)


def _chebyshev(count: int) -> tuple[Array, Array]:
    """Points (N + 1,) from 1 down to -1 and the matrix of derivatives there."""
    x = np.cos(np.pi * np.arange(count + 1) / count)
    c = np.hstack([2.0, np.ones(count - 1), 2.0]) * (-1.0) ** np.arange(count + 1)
    apart = x[:, None] - x[None, :]
    matrix = np.outer(c, 1 / c) / (apart + np.eye(count + 1))
    return x, matrix - np.diag(matrix.sum(axis=1))
