"""The flows: waves, a heavy fluid on a light one, a column that collapses, and a bubble."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import curve_fit
from tipfem.demos.support.figures import Curves
from tipfem.demos.validation.drops.theory import rising_bubble
from tipfem.demos.validation.three_d.theory import Wave, overturning

import tipfem as tp
from tipfem.mesh.measures import area_vectors, wall_faces
from tipfem.mesh.mesh import Mesh

Array = NDArray[np.float64]

GRAVITY = 9.81
WATER = tp.Fluid("water", density=1000.0, viscosity=1e-3)
LIQUID, GAS = tp.Fluid("liquid", density=1000.0, viscosity=10.0), tp.Fluid("gas", density=100.0, viscosity=1.0)
DAMPED = 0.3  # of a viscous wave's amplitude in a period
PERIODS, STEPS = 2.0, 150  # of waves, and steps in each
COLLAPSE = tuple(t / math.sqrt(2 * GRAVITY) for t in (0.5, 1.0, 1.5, 2.0, 2.5, 3.0))  # of a column 1 m wide [s]
FINE = 80  # spacings across the plane's tank, in which the bubble without tension has converged


def slipping(size: tuple[float, ...], spacing: float, *still: str, seed: int = 0) -> tp.case.tank.Tank:
    """A tank whose walls slip, but for the ``still`` ones."""
    tank = tp.tank(size, spacing, jitter=0.15 if len(size) == 3 else 0.0, seed=seed)
    for side in tank.sides:
        tank.wall(side, **({"law": "no-slip"} if side in still else {"slip": True}))
    return tank


def moment(simulation: tp.Simulation, shape: Callable[[Array], Array]) -> float:
    """Integral of a function of places (K, d) over the first fluid, exact for quadratic ones in space."""
    mesh = simulation.mesh
    x = mesh.position[mesh.cells[mesh.fluid == 0]]
    corners = x.shape[1]
    values = 0.8 * shape(x.mean(axis=1)) + 0.2 / corners * sum(shape(x[:, k]) for k in range(corners))
    return float(mesh.measure[mesh.fluid == 0] @ values)


def followed(simulation: tp.Simulation, end: float, measure: Callable[[], float]) -> tuple[Array, float]:
    """Times and values (2, K) of a measure until the end, and the largest change of the first fluid's volume."""
    name = simulation.case.fluids[0].name
    volume, course, worst = simulation.volume(name), [(simulation.time, measure())], 0.0
    while simulation.time < end - 1e-12:
        simulation.step(end)
        course.append((simulation.time, measure()))
        worst = max(worst, abs(simulation.volume(name) / volume - 1))
    return np.array(course).T, worst


def wave(halves: tuple[int, int], across: int, viscous: bool = False) -> tuple[dict[str, float], Curves]:
    """Errors of the frequency and of the damping of a standing wave of 0.3 spacings.

    Args:
        halves: half waves along both sides of a square tank.
        across: spacings in one side.
        viscous: whether the liquid takes `DAMPED` of the amplitude in a period, instead of being water.
    """
    size, nu = (1.0, 1.0, 0.5), 1e-6
    theory, amplitude = Wave(size, halves, nu, GRAVITY), 0.3 / across
    if viscous:
        nu = -math.log(1 - DAMPED) / (2 * theory.k**2) * theory.rate().imag / (2 * math.pi)
        theory = Wave(size, halves, nu, GRAVITY)
    n, liquid = theory.rate(), tp.Fluid("liquid", density=1000.0, viscosity=1000.0 * nu)
    tank = slipping((1.0, 1.0, 0.5 + 4 / across), 1 / across)
    tank.fill(liquid, box=((0, 0, 0), size), velocity=lambda x: theory.velocity(x, amplitude))
    case = tp.Case(tank, [liquid], (0, 0, -GRAVITY), free_surface=True)
    simulation = tp.Simulation(case, time_step=2 * math.pi / n.imag / STEPS)
    area = np.prod([0.5 if half else 1.0 for half in halves])
    end = PERIODS * 2 * math.pi / n.imag
    course, volume = followed(simulation, end, lambda: moment(simulation, theory.shape) / float(area))

    def mode(t: Array, a: float, w: float, d: float, p: float) -> Array:
        return np.asarray(a * np.exp(-d * t) * np.sin(w * t + p))

    found = curve_fit(mode, *course, [-amplitude, n.imag, -n.real, 0.0])[0]
    figures = {"frequency": found[1] / n.imag - 1, "volume": volume}
    if viscous:
        figures["damping"] = found[2] / -n.real - 1
    else:
        figures["lost"] = (found[2] + n.real) * 2 * math.pi / n.imag
    t, exact = course[0], -np.exp(n.real * course[0]) * np.sin(n.imag * course[0])
    return figures, ("amplitude / the first", {f"{across} across": (t, course[1] / amplitude), "theory": (t, exact)})


def overturns(across: int, atwood: float = 0.5, nu: float = 0.01) -> tuple[dict[str, float], Curves]:
    """Error of the rate at which a heavy fluid on a light one comes down, in half a wave along each side of a tank.

    The interface begins level, with the velocities of the mode without viscosity, and ends 0.3 spacings off.

    Args:
        across: spacings in one side, which is 1 m.
        atwood: number of Atwood.
        nu: kinematic viscosity of both, which makes the layer of shear at the interface 0.05 m thick [m^2/s].
    """
    mode, light = Wave((1.0, 1.0, 1.0), (1, 1), nu, GRAVITY), 1000.0 * (1 - atwood) / (1 + atwood)
    fluids = [tp.Fluid("heavy", 1000.0, 1000.0 * nu), tp.Fluid("light", light, light * nu)]
    k, (a, b) = mode.k, mode.numbers
    rate, amplitude = overturning(k, atwood, nu, GRAVITY), 0.4 / across

    def start(x: Array) -> Array:
        far = 1.0 - np.abs(x[:, 2] - 1.0)  # from the floor, or from the lid
        side = np.sign(1.0 - x[:, 2]) * (far < 1.0 - 0.1 / across)  # at the interface neither fluid's
        along, up = side * np.cosh(k * far) / (k * np.cosh(k)), np.sinh(k * far) / np.sinh(k)
        slope_x, slope_y = np.sin(a * x[:, 0]) * np.cos(b * x[:, 1]), np.cos(a * x[:, 0]) * np.sin(b * x[:, 1])
        directions = np.stack([-a * along * slope_x, -b * along * slope_y, up * mode.shape(x)], axis=1)
        return np.asarray(amplitude * rate / math.sinh(3.0) * directions)

    tank = slipping((1.0, 1.0, 2.0), 1 / across)
    tank.fill(fluids[0], velocity=start).fill(fluids[1], box=((0, 0, 0), (1.0, 1.0, 1.0)), velocity=start)
    simulation = tp.Simulation(tp.Case(tank, fluids, (0, 0, -GRAVITY)), time_step=0.05 / rate)
    course, volume = followed(simulation, 3.0 / rate, lambda: -4 * moment(simulation, mode.shape))

    def grown(t: Array, a: float, n: float, b: float, d: float) -> Array:
        return np.asarray(a * np.exp(n * t) + b * np.exp(-d * t))

    late = course[:, course[0] > 0.5 / rate]
    found = curve_fit(grown, *late, [amplitude / 20, rate, -amplitude / 20, rate])[0]
    t, first = course[0], found[0] * across
    lines = {f"{across} across": (t, course[1] * across), "theory": (t[t > 0.2], first * np.exp(rate * t[t > 0.2]))}
    return {"rate": float(found[1]) / rate - 1, "volume": volume}, ("amplitude [spacings]", lines)


def collapses(across: int, starts: int = 2) -> tuple[dict[str, float], Curves]:
    """Largest differences of front and height of a column from those in the plane, over the latter.

    Args:
        across: spacings in the column's width.
        starts: whose mean is taken.

    Returns:
        Those of the ``front``, in space the floor's wet area over the tank's width, and of the ``height`` at the wall;
        and ``energy``, what numerics took of the flow's, in space and in the plane.
    """
    plane, energy_there = _collapsed(2, across, 0)
    runs = [_collapsed(3, across, seed) for seed in range(starts)]
    space = np.mean([rows for rows, _ in runs], axis=0)
    front, height = np.abs(space / plane - 1).max(axis=0)
    energy = float(np.mean([taken for _, taken in runs]))
    figures = {"front": front, "height": height, "energy": energy, "energy_in_the_plane": energy_there}
    times = np.array(COLLAPSE)
    lines = {"front": (times, space[:, 0]), "height": (times, space[:, 1])}
    return figures, ("front, height [m]", lines | {"plane": (np.tile([*times, np.nan], 2), _joined(plane))})


def _joined(columns: Array) -> Array:
    """Columns (K, 2) one after the other (2 K + 2,), with gaps."""
    return np.concatenate([columns, np.full((1, 2), np.nan)]).T.ravel()


def _wet_floor(mesh: Mesh) -> float:
    """Area of the faces at a height of 0 [m^2], in the plane their length [m]."""
    x, faces = mesh.position, np.stack(mesh.hull[2:], axis=1) if mesh.dimension == 2 else wall_faces(mesh)[0]
    faces = faces[(x[faces][..., -1] < 1e-9).all(axis=1)]
    if mesh.dimension == 2:
        return float(np.abs(np.diff(x[faces, 0])).sum())
    return float(np.abs(area_vectors(x, faces)[:, 2]).sum())


def _collapsed(dimension: int, across: int, seed: int) -> tuple[Array, float]:
    """Front and height (K, 2) [m] at the times of `COLLAPSE`, and the energy that numerics took over the flow's."""
    thin = (0.5,) if dimension == 3 else ()
    tank = slipping((4.0, *thin, 2.4), 1 / across, seed=seed)
    tank.fill(WATER, box=((0.0,) * dimension, (1.0, *thin, 2.0)))
    case = tp.Case(tank, [WATER], (*(0.0,) * (dimension - 1), -GRAVITY), free_surface=True)
    simulation, rows = tp.Simulation(case, time_step=0.005), []
    for time in COLLAPSE:
        while simulation.time < time - 1e-12:
            simulation.step(time)
        mesh = simulation.mesh
        used = mesh.position[mesh.used]
        rows.append((_wet_floor(mesh) / math.prod(thin), used[used[:, 0] < 1e-9, -1].max()))
    return np.array(rows), simulation.numerical_error()["energy"]


def bubble(across: int, tension: bool = True) -> tuple[dict[str, float], Curves]:
    """Errors of the largest speed and of the rise in 3 s of a bubble in a tank four spacings thin.

    With tension they are of Hysing et al., case 1; without, of the plane with `FINE` spacings across.
    """
    found = _risen(3, across, tension)
    if tension:
        reference = rising_bubble()
        wanted = np.stack([reference["time"], reference["height"], reference["velocity"]])
    else:
        wanted = _risen(2, FINE, False)
    rise = (found[1, -1] - 0.5) / (np.interp(3.0, wanted[0], wanted[1]) - 0.5) - 1
    lines = {f"{across} across": (found[0], found[2]), "reference": (wanted[0], wanted[2])}
    return {"speed": found[2].max() / wanted[2].max() - 1, "rise": rise}, ("speed [m/s]", lines)


def _risen(dimension: int, across: int, tension: bool) -> Array:
    """Time, height and speed (3, K) of the bubble until 3 s."""
    thin, ends = ((4 / across,), ("back", "front")) if dimension == 3 else ((), ("bottom", "top"))
    tank = slipping((1.0, *thin, 2.0), 1 / across, *ends).fill(LIQUID)
    tank.fill(GAS, where=lambda x: np.hypot(x[:, 0] - 0.5, x[:, -1] - 0.5) < 0.25)
    options: dict[str, Any] = {"surface_tension": {("liquid", "gas"): 24.5}} if tension else {}
    case = tp.Case(tank, [LIQUID, GAS], (*(0.0,) * (dimension - 1), -0.98), **options)
    probe = tp.DropProbe(name="bubble", fluid="gas")
    simulation = tp.Simulation(case, time_step=0.02, probes=[probe])
    while simulation.time < 3.0 - 1e-12:
        simulation.step(3.0)
    course, axis = simulation.probes["bubble"], "yz"[dimension - 2]
    return np.array([course["time"], course[axis], course[f"velocity_{axis}"]])
