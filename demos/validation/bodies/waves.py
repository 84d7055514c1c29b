"""Bodies and waves: a cylinder that heaves on still water, and a wave maker; the cases, and linear theory."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import exp1
from tipfem.demos.validation.bodies.flows import AIR, GRAVITY, WATER

import tipfem as tp

Array = NDArray[np.float64]

# A cylinder half immersed in deep water, which is let go from a lift above where it floats.
RADIUS = 0.1  # [m]
LIFT = 0.15  # [radii]
DEPTH = 16.0  # of the water [radii]
WIDTH = 64.0  # of the tank [radii]
UNIT = math.sqrt(RADIUS / GRAVITY)  # of time [s]
MULTIPOLES = 12
HIGHEST = 20.0  # frequency in the integral of the motion [1/UNIT]


def heaving_cylinder(across: int) -> tp.Case:
    """A cylinder of half the density of water and air, lifted; ``across`` spacings in its radius."""
    spacing = RADIUS / across
    width, depth = WIDTH * RADIUS, DEPTH * RADIUS
    centre = np.array([0.5 * width, depth + LIFT * RADIUS])
    shape = tp.shapes.circle(centre, RADIUS)
    density = 0.5 * (WATER.density + AIR.density)
    body = tp.Body(shape, law="layer", name="cylinder", density=density, free=("y",))

    def near(x: Array) -> Array:
        far = np.maximum(np.hypot(*(x - centre).T) - 1.5 * RADIUS, 0.0)
        from_surface = np.maximum(np.abs(x[:, 1] - depth) - 0.5 * RADIUS, 0.0)
        along = np.maximum(np.abs(x[:, 0] - centre[0]) - 3 * RADIUS, 0.0)
        surface = spacing * (2.0 + np.minimum(along / RADIUS, 2.0)) + 0.2 * from_surface
        return np.minimum(np.minimum(spacing + 0.2 * far, surface), RADIUS)

    tank = tp.tank((width, depth + 4 * RADIUS), spacing).fill(AIR).fill(WATER, box=((0, 0), (width, depth))).add(body)
    for side in tank.sides:
        tank.wall(side, slip=True)
    return tp.Case(tank, [AIR, WATER], (0, -GRAVITY), grading=tp.Grading(where=near), title="A cylinder heaves")


def heave_response(time: Array) -> Array:
    """Heave (K,) over its start of a half-immersed circular cylinder that is let go at rest in deep water.

    Maskell & Ursell, The transient motion of a floating body, J. Fluid Mech. 44 (1970) 303-313: h_2. The equation of
    motion (M + A) x'' + B x' + 2 rho g a x = 0 in the frequency domain has the speed

        V(w) = -x_0 / (1 - pi/4 w^2 (1 + L(w))),  x(t) = x_0 + 2/pi int_0^inf Re V sin(w t) / w dw,

    in units of the radius a and of sqrt(a / g), with L = (A + i B / w) / M of `force_coefficient`.

    Args:
        time: (K,) [sqrt(a / g)].
    """
    frequency, coefficient = _coefficients()
    speed = -1.0 / (1.0 - 0.25 * math.pi * frequency**2 * (1.0 + coefficient))
    values = speed.real * np.sin(np.outer(time, frequency)) / frequency
    return np.asarray(1.0 + 2 / math.pi * np.trapezoid(values, frequency, axis=1))


@cache
def _coefficients() -> tuple[Array, NDArray[np.complex128]]:
    """Frequencies (F,), and the force coefficient at each."""
    frequency = np.concatenate([np.linspace(1e-6, 4.0, 801), np.geomspace(4.02, HIGHEST, 400)])
    return frequency, np.array([force_coefficient(w) for w in frequency])


def force_coefficient(frequency: float) -> complex:
    """Added mass and damping over the mass of the half cylinder of water: A / M + i B / (w M).

    F. Ursell, On the heaving motion of a circular cylinder on the surface of a fluid, Q. J. Mech. Appl. Math. 2 (1949)
    218-231: the potential is that of a wave source at the centre and of multipoles, each of which satisfies the
    condition at the free surface; their strengths fit the speed of the cylinder's surface, here by least squares.

    Args:
        frequency: w [sqrt(g / a)].
    """
    k = frequency**2
    angle = (np.arange(120) + 0.5) / 120 * (0.5 * math.pi)  # from the downward vertical; the flow is symmetric
    z = np.sin(angle) - 1j * np.cos(angle)  # x + i y on the surface, y upwards: e^{-i k z} decays downwards
    # Real and imaginary part of the source with outgoing waves, and their derivatives along the radius.
    source = _wave_source(k, z)
    step = 1e-5
    slope = (_wave_source(k, (1 + step) * z) - _wave_source(k, (1 - step) * z)) / (2 * step)
    potentials, slopes = [source], [slope]
    for m in range(1, MULTIPOLES + 1):
        even, odd = np.cos(2 * m * angle), np.cos((2 * m - 1) * angle)
        potentials.append(even + k / (2 * m - 1) * odd + 0j)
        slopes.append(-2 * m * even - k * odd + 0j)
    strength = np.linalg.lstsq(np.array(slopes).T, np.cos(angle) + 0j, rcond=None)[0]
    pressed = 2 * (np.array(potentials).T @ strength * np.cos(angle)).mean() * (0.5 * math.pi)
    # The force is i w rho times that integral of the potential, and -(A - B / (i w)) times the acceleration.
    return complex(-pressed / (0.5 * math.pi))


def _wave_source(k: float, z: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Potential (K,) of a source in the surface of deep water that radiates waves, as e^{-i w t}, at x + i y, x > 0.

    PV int_0^inf e^{q y} cos(q x) / (q - k) dq + i pi e^{k y} cos(k x).
    """
    w = 1j * z  # -y + i x for x + i y; e^{-q w} has e^{q y} cos(q x) as its real part
    principal = np.exp(-k * w) * (exp1(-k * w) - 1j * math.pi)
    return np.asarray(principal.real + 1j * math.pi * np.exp(k * z.imag) * np.cos(k * z.real))


# A tank with a wall at each end that moves as a piston: the one drives waves towards the other.
STEADY = 3.0  # place where the waves are measured, off the fields beside the piston [depths]
STEEPNESS = 0.02  # height over length of the waves
RAMP = 2.0  # the strokes grow to their length in that time [periods]
STEPS = 80  # in a period
# Wave number times depth: length of the tank [depths], and when the measurement begins [periods]. In the period from
# then on linear theory for this tank has the height of steady waves to 1 %: their front has passed, and the waves from
# the other end have not come.
WAVES = {0.8: (34.0, 3.0), 1.5: (28.0, 4.0), 2.5: (24.0, 5.5)}
MODES = 20.0  # largest wave number of the theory for the tank [1/depth]


def stroke_ratio(kh: float) -> float:
    """Height of the waves over the stroke of a piston, by linear theory (Dean & Dalrymple, 1991, section 6.2)."""
    return 2 * (math.cosh(2 * kh) - 1) / (math.sinh(2 * kh) + 2 * kh)


def wave_period(kh: float) -> float:
    """Of waves on water of depth 1 m [s]."""
    return 2 * math.pi / math.sqrt(GRAVITY * kh * math.tanh(kh))


def stroke(kh: float) -> float:
    """Of the pistons [m], for waves of the height `STEEPNESS` times their length."""
    return STEEPNESS * 2 * math.pi / kh / stroke_ratio(kh)


def shift(kh: float, time: Array) -> Array:
    """Displacement (K,) of both pistons at times (K,) [m]."""
    part = np.minimum(time / (RAMP * wave_period(kh)), 1.0)
    grown = part**3 * (10 - 15 * part + 6 * part**2)
    return np.asarray(0.5 * stroke(kh) * grown * np.sin(2 * math.pi * time / wave_period(kh)))


def wave_maker(kh: float, across: int) -> tp.Case:
    """Both ends of a closed tank move together; ``across`` spacings in the depth of the water, which is 1 m."""
    spacing, length = 1.0 / across, WAVES[kh][0]

    def near(x: Array) -> Array:
        return np.asarray(np.minimum(spacing + 0.2 * np.maximum(np.abs(x[:, 1] - 1.0) - 1.5 * spacing, 0.0), 0.12))

    tank = tp.tank((length, 1.4), spacing).fill(AIR).fill(WATER, box=((0, 0), (length, 1.0)))
    tank.wall("left", slip=True, motion=lambda t: float(shift(kh, np.array(t))))
    tank.wall("right", slip=True, motion=lambda t: -float(shift(kh, np.array(t))))
    tank.wall("bottom", slip=True).wall("top", slip=True)
    return tp.Case(tank, [AIR, WATER], (0, -GRAVITY), grading=tp.Grading(where=near), title="A piston makes waves")


def tank_waves(kh: float, time: Array) -> Array:
    """Elevation (K,) at `STEADY` by linear theory for the tank with both its pistons, from rest [m].

    The potential is U (x - L/2) with the speed U of the pistons, and the tank's standing waves cos(n pi x / L), which
    U' drives through the coefficients of x - L/2; each is integrated exactly for a force that is constant in a step.

    Args:
        kh: wave number times depth.
        time: (K,) rising [s].
    """
    length, period = WAVES[kh][0], wave_period(kh)
    n = np.arange(1, int(MODES * length / math.pi) + 1, 2)
    k = n * math.pi / length
    square = GRAVITY * k * np.tanh(k)
    rate = np.sqrt(square)
    dt = period / 400
    steps = np.arange(int(time[-1] / dt) + 3) * dt
    forced = np.zeros_like(steps)
    forced[1:-1] = np.diff(shift(kh, steps), 2) / dt**2
    drive = k * np.tanh(k) * 4 * length / (n * math.pi) ** 2 / square
    height, speed, found = np.zeros(len(k)), np.zeros(len(k)), np.zeros(len(steps))
    cosine, sine, shape = np.cos(rate * dt), np.sin(rate * dt), np.cos(k * STEADY)
    for step in range(len(steps) - 1):
        rest = drive * 0.5 * (forced[step] + forced[step + 1])
        off = height - rest
        height, speed = rest + off * cosine + speed / rate * sine, speed * cosine - off * rate * sine
        found[step + 1] = shape @ height
    return np.asarray(np.interp(time, steps, found))


def wave_window(kh: float) -> tuple[float, float]:
    """Start and end of the period in which the waves at `STEADY` are measured [s]."""
    period = wave_period(kh)
    return WAVES[kh][1] * period, (WAVES[kh][1] + 1) * period


def wave_height(time: Array, level: Array, kh: float) -> float:
    """Height of the waves of the period in a signal (K,) [m], by least squares over `wave_window`."""
    start, end = wave_window(kh)
    kept = (time >= start) & (time <= end)
    phase = 2 * math.pi / wave_period(kh) * time[kept]
    basis = np.stack([np.cos(phase), np.sin(phase), np.ones_like(phase)], axis=1)
    cosine, sine, _ = np.linalg.lstsq(basis, level[kept], rcond=None)[0]
    return float(2 * math.hypot(cosine, sine))
