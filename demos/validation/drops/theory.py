"""What is known of flows with surface tension: closed forms, and solutions of ordinary differential equations."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, minimize_scalar
from scipy.special import wofz

Array = NDArray[np.float64]


def rising_bubble() -> dict[str, Array]:
    """Time, circularity, height of the centre and its velocity in the first case of Hysing et al. (2009)."""
    path = Path(__file__).with_name("hysing2009_case1.csv")
    table = np.genfromtxt(path, delimiter=",", names=True, skip_header=2)
    return {name: table[name] for name in table.dtype.names}


def capillary_wave(time: Array, wave_number: float, viscosity: float, omega: float) -> Array:
    """Amplitude (K,) at times (K,) of a standing wave between two fluids of one density and viscosity, 1 at the start.

    A. Prosperetti, Motion of two superposed viscous fluids, Physics of Fluids 24, 1981.

    Args:
        time: [s].
        wave_number: k [1/m].
        viscosity: kinematic [m^2/s].
        omega: the frequency without viscosity [1/s].
    """
    damping = viscosity * wave_number**2
    roots = np.roots([1, -math.sqrt(damping), -damping, damping**1.5, omega**2])
    result = np.zeros(len(time), dtype=complex)
    for i, z in enumerate(roots):
        others = np.prod([other - z for j, other in enumerate(roots) if j != i])
        result += z / others * omega**2 / (z**2 - damping) * np.exp(-damping * time) * wofz(1j * z * np.sqrt(time))
    return np.asarray(result.real)


def oscillation(mode: int, sigma: float, radius: float, inner: float, outer: float, room: float) -> float:
    """Frequency of a drop without viscosity in two dimensions, in the middle of a round room [1/s].

    H. Lamb, Hydrodynamics, 1932, with the outer potential r^-n + r^n / room^2n, whose normal velocity vanishes there.

    Args:
        mode: n.
        sigma: tension [N/m].
        radius: of the drop [m].
        inner: density of the drop [kg/m^3].
        outer: density of the fluid around it [kg/m^3].
        room: radius of the room [m].
    """
    near = (radius / room) ** (2 * mode)
    inertia = inner + outer * (1 + near) / (1 - near)
    return math.sqrt(mode * (mode**2 - 1) * sigma / (inertia * radius**3))


def sessile_radius(area: float, angle: float) -> float:
    """Radius of the arc of a drop of an ``area`` [m^2] on a floor, without gravity, for a contact angle [radians]."""
    return math.sqrt(area / (angle - math.sin(angle) * math.cos(angle)))


def lens(area: float, surface: float, upper: float, lower: float) -> tuple[float, float, float]:
    """Half the width [m] of a lens without gravity on a surface, and the angles of its two arcs with it [radians].

    Neumann's triangle: the tension of the surface is the sum of those of both arcs, as vectors.

    Args:
        area: of the lens [m^2].
        surface: tension beside the lens [N/m].
        upper: tension of its upper arc [N/m].
        lower: tension of its lower arc [N/m].
    """
    above, below = (
        math.acos((surface**2 + one**2 - other**2) / (2 * surface * one))
        for one, other in ((upper, lower), (lower, upper))
    )
    segments = sum((angle - math.sin(angle) * math.cos(angle)) / math.sin(angle) ** 2 for angle in (above, below))
    return math.sqrt(area / segments), above, below


def meniscus(half_width: float, length: float, angle: float) -> float:
    """Height of the contacts above the middle of a meniscus between two plates [m].

    psi' = 1 / R_0 + y / length^2 along the arc, with the slope psi and the radius R_0 in the middle.

    Args:
        half_width: of the gap [m].
        length: sqrt(sigma / (rho g)) with the difference of the densities [m].
        angle: of the contacts [radians].
    """

    def end(curvature: float) -> Array:
        there = lambda s, z: z[0] - half_width  # noqa: E731
        there.terminal = True  # type: ignore[attr-defined]
        slopes = lambda s, z: [math.cos(z[2]), math.sin(z[2]), curvature + z[1] / length**2]  # noqa: E731
        found = solve_ivp(slopes, (0, 10 * half_width), [0, 0, 0], events=there, rtol=1e-10, atol=1e-13)
        return np.asarray(found.y[:, -1])

    wanted = math.pi / 2 - angle
    # Without gravity the curvature is cos(angle) / half_width; with it the middle is flatter.
    bounds = np.array([1e-3, 1.2]) * math.cos(angle) / half_width
    curvature = brentq(lambda each: end(each)[2] - wanted, *bounds, xtol=1e-12)
    return float(end(curvature)[1])


def floating_disc(radius: float, angle: float, weight: float) -> tuple[float, float]:
    """Heights of the centre of a disc that floats, and of its contacts, above the level far from it.

    Lengths are in sqrt(sigma / (rho g)), forces in sigma. At the polar angle phi of the contacts, from below, the
    interface rises outwards at alpha = angle + phi - pi, from the height -2 sin(alpha / 2). It carries 2 sin(alpha),
    and the pressure of the liquid the weight of that between the wetted arc and the level.

    Args:
        radius: of the disc.
        angle: of the contacts [radians].
        weight: of the disc, less that of as much light fluid.
    """

    def carried(phi: float) -> tuple[float, float]:
        rises = angle + phi - math.pi
        contact = -2 * math.sin(rises / 2)
        displaced = radius**2 * (phi - math.sin(phi) * math.cos(phi)) - 2 * radius * math.sin(phi) * contact
        return 2 * math.sin(rises) + displaced, contact

    phi = brentq(lambda each: carried(each)[0] - weight, 0.05, math.pi - 0.05)
    contact = carried(phi)[1]
    return contact + radius * math.cos(phi), contact


def largest_hanging_drop() -> float:
    """Area of the largest drop that hangs under a ceiling at 90 degrees, over sigma / (rho g).

    Its outline is psi' = k - y along the arc from the lowest point, in units of sqrt(sigma / (rho g)), so that
    cos(psi) = 1 - k y + y^2 / 2. It meets the ceiling where psi is 90 degrees for the second time, above its waist.
    """

    def area(curvature: float) -> float:
        height = curvature + math.sqrt(curvature**2 - 2)
        there = lambda s, z: z[1] - height  # noqa: E731
        there.terminal = True  # type: ignore[attr-defined]
        slopes = lambda s, z: [math.cos(z[2]), math.sin(z[2]), curvature - z[1], 2 * z[0] * math.sin(z[2])]  # noqa: E731
        return float(solve_ivp(slopes, (0, 20), [0, 0, 0, 0], events=there, rtol=1e-9, atol=1e-11).y[3, -1])

    best = minimize_scalar(lambda k: -area(k), bounds=(1.45, 1.65), method="bounded")
    return -float(best.fun)


def rayleigh_taylor(wave_number: float, densities: tuple[float, float], gravity: float, sigma: float) -> float:
    """Square of the rate of growth of a wave between a heavy fluid and a light one below it, both deep [1/s^2].

    Args:
        wave_number: k [1/m].
        densities: of the upper and of the lower fluid [kg/m^3].
        gravity: g [m/s^2].
        sigma: tension [N/m].
    """
    upper, lower = densities
    return ((upper - lower) * gravity * wave_number - sigma * wave_number**3) / (upper + lower)
