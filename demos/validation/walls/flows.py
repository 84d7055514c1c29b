"""Flows along walls that slip, slide and move, each with what is known about it in closed form.

What `run.py` runs. Sources:

    Taylor-Green vortex: G. I. Taylor and A. E. Green, Proc. R. Soc. A 158 (1937) 499-521; here one cell of it, with
        free slip on all four sides.
    Navier's slip: C. L. M. H. Navier, Mem. Acad. R. Sci. Inst. France 6 (1823) 389-440.
    Fluid in a tank that turns: the streamfunction psi relative to the tank has lap psi = 2 omega, psi = 0 on the
        walls (H. Lamb, Hydrodynamics, 6th ed., 1932, art. 72); the series is that of the torsion of a square bar.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator

import tipfem as tp

Array = NDArray[np.float64]
SIDES = ("left", "right", "bottom", "top")


def advance(simulation: tp.Simulation, until: float) -> tp.Simulation:
    """Step to a time [s]."""
    while simulation.time < until:
        simulation.step(until)
    return simulation


def profile(simulation: tp.Simulation, points: Array) -> Array:
    """Velocity (K, 2) [m/s] at points (K, 2), linear in the triangles between the particles."""
    return np.asarray(LinearNDInterpolator(simulation.particles.position, simulation.particles.velocity)(points))


# Taylor-Green vortex: u = (sin kx cos ky, -cos kx sin ky) exp(-2 nu k^2 t) in a box of pi / k.


def taylor_green(cells: int, viscosity: float = 0.1, *, jitter: float = 0.0) -> tp.Simulation:
    """The vortex in the unit square with ``cells`` spacings a side, k = pi, density 1, U = 1 m/s."""
    fluid = tp.Fluid("fluid", 1.0, viscosity)
    tank = tp.tank((1, 1), 1 / cells, jitter=jitter).fill(fluid)
    particles = tank.sample([fluid])
    x = particles.position
    particles.velocity, k = taylor_green_velocity(x, 0.0, viscosity), np.pi
    particles.velocity[np.abs(particles.velocity) < 1e-12] = 0.0  # sin(pi) is not quite zero
    convective = 0.5 * k * np.sin(2 * k * x)
    particles.acceleration = convective - 2 * viscosity * k**2 * particles.velocity
    case = tp.Case(
        particles,
        [fluid],
        (0, 0),
        numerics=tp.Numerics(newton_tolerance=1e-6),
        walls=[
            tp.Wall(f"{c}{axis}", particles=np.flatnonzero(x[:, axis] == c), slip=True)
            for axis in (0, 1)
            for c in (0.0, 1.0)
        ],
    )
    return tp.Simulation(case, time_step=0.35 / cells)


def taylor_green_velocity(x: Array, time: float, viscosity: float) -> Array:
    """Velocity (K, 2) [m/s] of the vortex at x (K, 2) [m]."""
    k = np.pi
    s, c = np.sin(k * x), np.cos(k * x)
    decayed = np.exp(-2 * viscosity * k**2 * time)
    return np.asarray(decayed * np.stack([s[:, 0] * c[:, 1], -c[:, 0] * s[:, 1]], axis=1))


# Long cavity under a moving lid: in its middle the flow is that of a channel without net flow.


def long_cavity(
    cells: int, *, slip_length: float | None = None, ratio: float | None = None, aspect: float = 6.0
) -> tp.Simulation:
    """A cavity 1 m high and ``aspect`` m long under a lid at 1 m/s.

    Args:
        cells: spacings over the height.
        slip_length: of the floor [m]; None for no slip.
        ratio: viscosity of the lower half over that of the upper; None for one fluid. Densities are equal.
        aspect: length over height.
    """
    fluids = [tp.Fluid("upper", 1.0, 1.0)]
    tank = tp.tank((aspect, 1), 1 / cells, jitter=0.2).fill(fluids[0]).wall("top", velocity=(1.0, 0.0))
    if ratio is not None:
        fluids.append(tp.Fluid("lower", 1.0, ratio))
        tank.fill(fluids[1], box=((0, 0), (aspect, 0.5)))
    if slip_length is not None:
        tank.wall("bottom", slip_length=slip_length)
    return tp.Simulation(tp.Case(tank, fluids, (0, 0)), time_step=0.2 / cells)


def channel(slip_length: float = 0.0, ratio: float = 1.0) -> Callable[[Array], Array]:
    """u(y) / U for y in (0, 1) of the channel under a lid, with no net flow; see `long_cavity`.

    u = a + b y + c y^2 in each half, with mu c the same in both (one pressure gradient), u and mu u' continuous,
    u(0) = l u'(0), u(1) = 1 and no net flow. Without slip and of one fluid it is 3 y^2 - 2 y.
    """
    l, m, h = slip_length, ratio, 0.5
    rows: list[tuple[list[float], float]] = [  # a, b, c of the lower half; a, b, c of the upper
        ([1, -l, 0, 0, 0, 0], 0),
        ([0, 0, 0, 1, 1, 1], 1),
        ([1, h, h**2, -1, -h, -(h**2)], 0),
        ([0, m, 2 * m * h, 0, -1, -2 * h], 0),
        ([0, 0, m, 0, 0, -1], 0),
        ([h, h**2 / 2, h**3 / 3, 1 - h, (1 - h**2) / 2, (1 - h**3) / 3], 0),
    ]
    a = np.linalg.solve([row for row, _ in rows], [rhs for _, rhs in rows])
    return lambda y: np.where(y < h, a[0] + a[1] * y + a[2] * y**2, a[3] + a[4] * y + a[5] * y**2)


# Square cavity under a moving lid.


def driven_cavity(reynolds: float, cells: int, *, lid: float = 1.0) -> tp.Simulation:
    """The unit square under a lid at ``lid`` m/s, with ``cells`` spacings a side."""
    fluid = tp.Fluid("fluid", 1.0, lid / reynolds)
    tank = tp.tank((1, 1), 1 / cells, jitter=0.2).fill(fluid).wall("top", velocity=(lid, 0.0))
    return tp.Simulation(tp.Case(tank, [fluid], (0, 0)), time_step=0.35 / cells / lid)


# Moving tanks, full of one fluid.


def swayed(cells: int, *, slip: bool) -> tuple[tp.Simulation, Callable[[float], tuple[Array, Array]]]:
    """A tank of water that is shaken and lifted; with its velocity (2,) and acceleration (2,) at a time."""
    size, w = 0.05, 4.0
    motion = tp.Motion(translation=lambda t: (size * (1 - np.cos(w * t)), 0.2 * t**2))
    fluid = tp.Fluid("fluid", 1000.0, 1.0)
    tank = tp.tank((1, 0.6), 1 / cells, jitter=0.2).fill(fluid)
    for side in SIDES if slip else ():
        tank.wall(side, slip=True)

    def rates(t: float) -> tuple[Array, Array]:
        return np.array([size * w * np.sin(w * t), 0.4 * t]), np.array([size * w**2 * np.cos(w * t), 0.4])

    return tp.Simulation(tp.Case(tank, [fluid], (0, -9.81), tank_motion=motion), time_step=0.005), rates


SWAY = (0.34, 1.2)  # amplitude [m] and frequency [rad/s]
LAYERS = (1000.0, 700.0)  # densities of the lower and the upper half [kg/m^3]


def sloshed(cells: int) -> tp.Simulation:
    """Two layers of little viscosity in a square tank of 1 m with walls of free slip, which sways."""
    lower, upper = tp.Fluid("lower", LAYERS[0], 0.02), tp.Fluid("upper", LAYERS[1], 0.02)
    tank = tp.tank((1, 1), 1 / cells).fill(upper).fill(lower, box=((0, 0), (1, 0.5)))
    for side in SIDES:
        tank.wall(side, slip=True)
    motion = tp.Motion(translation=lambda t: (SWAY[0] * (1 - np.cos(SWAY[1] * t)), 0.0))
    return tp.Simulation(tp.Case(tank, [lower, upper], (0, -9.81), tank_motion=motion), time_step=0.24 / cells)


def first_moment(simulation: tp.Simulation) -> float:
    """Integral of x over the lower fluid of `sloshed`, from the tank's centre [m^3, per metre of depth]."""
    mesh = simulation.mesh
    part = simulation.state.material.fraction[:, 0]
    centre = 0.5 + SWAY[0] * (1 - np.cos(SWAY[1] * simulation.time))
    return float((mesh.measure * part) @ (mesh.position[mesh.cells, 0].mean(axis=1) - centre))


def linear_moment(time: Array, terms: int = 40) -> Array:
    """The same (K,) by linear theory: waves cos kx on the interface, forced by the tank's acceleration a.

    eta'' + w_k^2 eta = w_k^2 4 a / (g k^2) for k = pi, 3 pi ..., from rest, with (Lamb, Hydrodynamics, art. 231)
    w_k^2 = (rho_1 - rho_2) g k tanh(k / 2) / (rho_1 + rho_2); the integral of x cos kx is -2 / k^2.
    """
    time, (size, w) = np.asarray(time)[:, None], SWAY
    k = np.pi * np.arange(1, terms, 2)
    own = np.sqrt((LAYERS[0] - LAYERS[1]) / sum(LAYERS) * 9.81 * k * np.tanh(k / 2))
    force = 4 * size * w**2 / (9.81 * k**2)
    eta = force * own**2 / (own**2 - w**2) * (np.cos(w * time) - np.cos(own * time))
    return np.asarray((-2 / k**2 * eta).sum(axis=1))


ROLL = (0.5, 1.0)  # amplitude [rad] and frequency [rad/s]


def rolled(cells: int) -> tp.Simulation:
    """A square tank with walls of free slip that rolls about its centre, full of a fluid of next to no viscosity."""
    fluid = tp.Fluid("fluid", 1.0, 1e-6)
    tank = tp.tank((1, 1), 1 / cells, jitter=0.1).fill(fluid)
    for side in SIDES:
        tank.wall(side, slip=True)
    motion = tp.Motion(angle=lambda t: ROLL[0] * (1 - np.cos(ROLL[1] * t)), pivot=(0.5, 0.5))
    return tp.Simulation(tp.Case(tank, [fluid], (0, 0), tank_motion=motion), time_step=0.6 / cells)


def rolled_velocity(x: Array, time: float, terms: int = 60) -> Array:
    """Velocity (K, 2) [m/s] of the fluid in `rolled` at x (K, 2) [m]: it keeps its vorticity of zero."""
    spin, angle = ROLL[0] * ROLL[1] * np.sin(ROLL[1] * time), ROLL[0] * (1 - np.cos(ROLL[1] * time))
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    y = (x - 0.5) @ rotation  # in the tank's frame, from its centre
    u = spin * np.stack([-y[:, 1], y[:, 0]], axis=1)
    for i in range(1, terms, 2):
        for j in range(1, terms, 2):
            psi = -2 * spin * 16 / (np.pi**4 * i * j * (i**2 + j**2))
            a, b = i * np.pi * (y[:, 0] + 0.5), j * np.pi * (y[:, 1] + 0.5)
            u[:, 0] += psi * j * np.pi * np.sin(a) * np.cos(b)
            u[:, 1] -= psi * i * np.pi * np.cos(a) * np.sin(b)
    return np.asarray(u @ rotation.T)


def stroke(time: float) -> float:
    """How far the walls of `pistons` have moved at a time [m]."""
    return float(0.15 * (1 - np.cos(2 * time)))


def pistons(cells: int, *, slip: bool) -> tp.Simulation:
    """A closed channel, 1 m x 0.4 m, whose ends move together, over floors that slip or do not."""
    fluid = tp.Fluid("fluid", 1000.0, 1.0)
    tank = tp.tank((1, 0.4), 0.4 / cells, jitter=0.2).fill(fluid)
    tank.wall("left", motion=stroke).wall("right", motion=lambda t: -stroke(t))
    for side in ("bottom", "top") if slip else ():
        tank.wall(side, slip=True)
    return tp.Simulation(tp.Case(tank, [fluid], (0, -9.81)), time_step=0.01)
