"""Drops, waves, a bubble and a film that move by surface tension."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import curve_fit
from tipfem.demos.validation.dam_break import case as dam_break_case
from tipfem.demos.validation.dam_break.check import front_figures
from tipfem.demos.validation.drops import theory
from tipfem.demos.validation.drops.at_rest import RADIUS, interface, pair, simulated, slippery

import tipfem as tp

Array = NDArray[np.float64]

SWING, PERIODS, STEPS = 0.01, 2.0, 200  # amplitude of an oscillating drop [radii], its periods, and steps in each
INVISCID = 1e6  # sigma rho D / mu^2 of the drop that oscillates
WAVE_LAPLACE, WAVE_AMPLITUDE = 3000.0, 0.01  # of the capillary wave; its amplitude [wavelengths]
DENSITIES = (1.0, 0.5)  # of the fluids that are upside down, the upper one first
TENSIONS = (0.8, 1.2)  # of these fluids, over the one at which a wave neither grows nor swings
OHNESORGE = 0.1  # mu / sqrt(rho sigma e) of the film of thickness e
SWEPT = 8.0, 16.0  # between these its speed is measured [e]
# Of the bubble that rises: its liquid and the bubble, its place, gravity [m/s^2] and tension [N/m].
BUBBLE = [tp.Fluid("liquid", 1000.0, 10.0), tp.Fluid("bubble", 100.0, 1.0)]
BUBBLE_DISC, BUBBLE_GRAVITY, BUBBLE_TENSION = ((0.5, 0.5), 0.25), 0.98, 24.5
WATER_TENSION = 0.0728  # with air [N/m]
RIM = 0.6  # half the film's thickness, from which on it is the rim [e]


def oscillating(ratio: float, across: int = 16) -> dict[str, float]:
    """A drop that is let go as an ellipse of 1 %: error of its frequency.

    Args:
        ratio: density around the drop, over its own.
        across: spacings in its diameter.
    """
    size, viscosity = 5 * RADIUS, math.sqrt(2 * RADIUS / INVISCID)
    fluids, middle = pair(ratio, viscosity), np.full(2, size / 2)

    def inside(x: Array) -> NDArray[np.bool_]:
        away = x - middle
        angle = np.arctan2(away[:, 1], away[:, 0])
        radius = RADIUS / math.sqrt(1 + SWING**2 / 2) * (1 + SWING * np.cos(2 * angle))
        return np.asarray(np.hypot(*away.T) < radius)

    tank = tp.tank((size, size), 2 * RADIUS / across, jitter=0.15).fill(fluids[1]).fill(fluids[0], where=inside)
    omega = theory.oscillation(2, 1.0, RADIUS, 1.0, ratio, size / 2)
    period = 2 * math.pi / omega
    simulation = simulated(tank, fluids)
    simulation.control.largest = period / STEPS
    course = [(0.0, _mode(simulation, middle))]
    while simulation.time < PERIODS * period:
        simulation.step()
        course.append((simulation.time, _mode(simulation, middle)))
    times, amplitude = np.array(course).T
    swing = lambda t, a, w, g, p, c: a * np.exp(-g * t) * np.cos(w * t + p) + c  # noqa: E731
    found = curve_fit(swing, times, amplitude, [SWING, omega, 0.01, 0.0, 0.0])[0]
    return {"frequency": found[1] / omega - 1, "decay": found[2] / omega}


def moving(spacing: float, steps: int = 100) -> dict[str, float]:
    """A drop of water of 3 mm that flies through air at 0.5 m/s: Krylov iterations in a step.

    Args:
        spacing: [mm].
        steps: of the largest step.
    """
    fluids = [tp.Fluid("water", 998.2, 1.002e-3), tp.Fluid("air", 1.204, 1.825e-5)]
    tank = tp.tank((0.012, 0.008), 1e-3 * spacing, jitter=0.15).fill(fluids[1])
    tank.fill(fluids[0], disc=((0.004, 0.004), 0.0015), velocity=(0.5, 0))
    simulation = tp.Simulation(tp.Case(tank, fluids, (0, 0), surface_tension={("water", "air"): WATER_TENSION}))
    for _ in range(steps):
        simulation.step()
    iterations = [row["krylov_iterations"] for row in simulation.history]
    return {"krylov_iterations": float(np.mean(iterations)), "first_step": iterations[0]}


def _mode(simulation: tp.Simulation, middle: Array) -> float:
    """Amplitude of cos(2 phi) in the radius of the interface [RADIUS]."""
    a, b = (x - middle for x in interface(simulation))
    turn = np.arctan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], (a * b).sum(axis=1))
    x = 0.5 * (a + b)
    radius, angle = np.hypot(*x.T), np.arctan2(x[:, 1], x[:, 0])
    return float((radius * np.cos(2 * angle)) @ np.abs(turn)) / (math.pi * RADIUS)


def wave(points: int) -> dict[str, float]:
    """A standing capillary wave between fluids of one density and viscosity: error of its amplitude.

    The setting is that of S. Popinet & S. Zaleski, A front-tracking algorithm for accurate representation of surface
    tension, International Journal for Numerical Methods in Fluids 30, 1999.

    Args:
        points: spacings in a wavelength, which is 1 m.

    Returns:
        error: root mean square until 25 / omega, over the amplitude at the start.
    """
    k, viscosity = 2 * math.pi, WAVE_LAPLACE**-0.5
    omega = math.sqrt(k**3 / 2)
    fluids = pair(1.0, viscosity)
    tank = tp.tank((0.5, 2.0), 1 / points, jitter=0.1).fill(fluids[1])
    tank.fill(fluids[0], where=lambda x: x[:, 1] < 1.0 + WAVE_AMPLITUDE * np.cos(k * x[:, 0]))
    simulation = simulated(slippery(tank), fluids)
    course = [(0.0, _height(simulation, 1.0, k))]
    while simulation.time < 25 / omega:
        simulation.step()
        course.append((simulation.time, _height(simulation, 1.0, k)))
    times, height = np.array(course).T
    error = height / WAVE_AMPLITUDE - theory.capillary_wave(times, k, viscosity, omega)
    return {"error": float(np.sqrt(np.mean(error**2)))}


def _height(simulation: tp.Simulation, level: float, k: float) -> float:
    """Amplitude of cos(k x) in the height of the interface over a ``level``, in half a wavelength [m]."""
    a, b = interface(simulation)
    middle, width = 0.5 * (a + b), np.abs(a - b)[:, 0]
    return float(((middle[:, 1] - level) * np.cos(k * middle[:, 0])) @ width) * 2 * k / math.pi


def bubble(across: int, end: float = 3.0) -> dict[str, Any]:
    """A bubble that rises, against the first case of Hysing et al. (2009).

    Args:
        across: spacings in the tank's width of 1 m.
        end: of the run [s].

    Returns:
        Relative errors of ``height``, ``velocity`` and ``circularity``, in the mean square over time, and ``course``:
        time, circularity, height and velocity of each step.
    """
    simulation = tp.Simulation(rising(across))
    probe = tp.DropProbe(name="bubble", fluid="bubble")
    course, iterations = [], 0.0
    while simulation.time < end:
        simulation.step(until=end)
        _, _, height, _, _, circularity, *_ = probe.sample(simulation)
        course.append((simulation.time, circularity, height))
        iterations += simulation.history[-1]["krylov_iterations"]
    found, errors = against_benchmark(np.array(course))
    return {**errors, "krylov_iterations": iterations / len(course), "course": found.tolist()}


def rising(across: int) -> tp.Case:
    """The first case of Hysing et al. (2009), with ``across`` spacings in the tank's width."""
    tank = tp.tank((1.0, 2.0), 1 / across).fill(BUBBLE[0]).fill(BUBBLE[1], disc=BUBBLE_DISC)
    for side, given in (("left", {"slip": True}), ("right", {"slip": True}), ("bottom", {}), ("top", {})):
        tank.wall(side, **(given or {"law": "no-slip"}))
    return tp.Case(tank, BUBBLE, (0, -BUBBLE_GRAVITY), surface_tension={("liquid", "bubble"): BUBBLE_TENSION})


def against_benchmark(course: Array) -> tuple[Array, dict[str, float]]:
    """The course (K, 3) of a bubble, time, circularity and height, with its velocity; and their relative errors.

    The velocity is that of the height at the ends of the steps. Errors are in the mean square over time.
    """
    times, circularity, height = course.T
    found, wanted = np.stack([times, circularity, height, np.gradient(height, times)]), theory.rising_bubble()
    here = times <= wanted["time"][-1]
    result: dict[str, float] = {}
    for name, values in zip(("circularity", "height", "velocity"), found[1:, here], strict=True):
        reference = np.interp(times[here], wanted["time"], wanted[name])
        result[name] = float(np.linalg.norm(values - reference) / np.linalg.norm(reference))
    return found.T, result


def rayleigh_taylor(points: int) -> dict[str, float]:
    """A heavy fluid on a light one, with tensions around the critical one: error of the critical wave number.

    The square of the rate of growth of a wave is linear in the tension. It is measured for two tensions.

    Args:
        points: spacings in a wavelength, which is 1 m.
    """
    k, gravity = 2 * math.pi, 1.0
    critical = (DENSITIES[0] - DENSITIES[1]) * gravity / k**2
    squares = [_growth(points, part * critical, gravity) for part in TENSIONS]
    wanted = [theory.rayleigh_taylor(k, DENSITIES, gravity, part * critical) for part in TENSIONS]
    zero = TENSIONS[0] + squares[0] * (TENSIONS[1] - TENSIONS[0]) / (squares[0] - squares[1])
    slope = (squares[1] - squares[0]) / (wanted[1] - wanted[0])
    return {"wave_number": zero**-0.5 - 1, "slope": slope - 1}


def _growth(points: int, sigma: float, gravity: float) -> float:
    """Square of the rate of growth of a wave of 1 m, from its course until three times 1 / |n| [1/s^2]."""
    k, level, start = 2 * math.pi, 1.0, 0.002
    fluids = [tp.Fluid("upper", DENSITIES[0], 1e-6), tp.Fluid("lower", DENSITIES[1], 1e-6)]
    tank = tp.tank((0.5, 2 * level), 1 / points, jitter=0.1).fill(fluids[0])
    tank.fill(fluids[1], where=lambda x: x[:, 1] < level + start * np.cos(k * x[:, 0]))
    tension = {("upper", "lower"): sigma}
    simulation = tp.Simulation(tp.Case(slippery(tank), fluids, (0, -gravity), surface_tension=tension))
    rate = theory.rayleigh_taylor(k, DENSITIES, gravity, sigma)
    course = [(0.0, _height(simulation, level, k))]
    while simulation.time < 2 / math.sqrt(abs(rate)):
        simulation.step()
        course.append((simulation.time, _height(simulation, level, k)))
    times, height = np.array(course).T
    # From rest, a cosh(n t) or a cos(|n| t).
    grown = lambda t, a, square: a * np.cosh(np.sqrt(complex(square)) * t).real  # noqa: E731
    return float(curve_fit(grown, times, height, [start, rate])[0][1])


def film(thickness: int = 4) -> dict[str, float]:
    """A film of liquid with a free end, which draws back: error of the speed of the middle of its rim.

    The rim at its end, which takes up the film, moves at sqrt(2 sigma / (rho e)) (G. I. Taylor, The dynamics of thin
    sheets of fluid, Proceedings of the Royal Society A 253, 1959; F. E. C. Culick, Comments on a ruptured soap film,
    Journal of Applied Physics 31, 1960). The rim becomes longer, so that its end is slower, and its inner edge faster.

    Args:
        thickness: e in spacings; it is 1 m.
    """
    thick, length, height = 1.0, 26.0, 8.0
    fluids = pair(1e-3, OHNESORGE)
    tank = tp.tank((length + 2, height), thick / thickness, jitter=0.1).fill(fluids[1])
    y = height / 2
    tank.fill(fluids[0], box=((0, y - thick / 2), (length - thick / 2, y + thick / 2)))
    tank.fill(fluids[0], disc=((length - thick / 2, y), thick / 2))
    simulation, course = simulated(slippery(tank), fluids), [(0.0, length, length)]
    while course[-1][1] > length - SWEPT[1] * thick:
        simulation.step()
        x = np.concatenate(interface(simulation))
        rim = x[np.abs(x[:, 1] - y) > RIM * thick, 0]
        course.append((simulation.time, float(x[:, 0].max()), float(rim.min(initial=length))))
    times, end, edge = np.array(course).T
    late = end < length - SWEPT[0] * thick
    tip, inner = (-np.polyfit(times[late], each[late], 1)[0] for each in (end, edge))
    speed = math.sqrt(2 / thick)
    return {"speed": 0.5 * (tip + inner) / speed - 1, "end": tip / speed - 1, "edge": inner / speed - 1}


def dam_break(spacing: float, rounds: int = 3, end: float = 0.25) -> dict[str, float]:
    """The dam break with the tension of water and without, in turns: does it cost accuracy, or time?

    Args:
        spacing: [m].
        rounds: how often both run.
        end: of the runs, before the front meets the other wall [s].

    Returns:
        front: relative change of the front's place at the end.
        rms: of the front against Martin & Moyce, and without tension.
        time: median processor time over that without.
    """
    fronts, times, rms = [0.0, 0.0], np.empty((2, rounds)), [0.0, 0.0]
    for turn in range(rounds):
        for k, tension in enumerate((None, {("water", "air"): WATER_TENSION})):
            case = dam_break_case.build(spacing, surface_tension=tension)
            step = dam_break_case.TIME_STEP * spacing / dam_break_case.SPACING
            simulation = tp.Simulation(case, time_step=step, columns={"front": dam_break_case.front})
            begun = time.process_time()
            while simulation.time < end:
                simulation.step(until=end)
            times[k, turn] = time.process_time() - begun
            fronts[k], rms[k] = simulation.history[-1]["front"], front_figures(simulation.history)["front_rms"]
    ratio = float(np.divide(*np.median(times, axis=1)[::-1]))
    return {"front": fronts[1] / fronts[0] - 1, "rms": rms[1], "rms_without": rms[0], "time": ratio}
