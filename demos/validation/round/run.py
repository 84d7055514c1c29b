"""Axisymmetric flows against theory.

rest: layers of water and air on a jittered mesh, with each law of walls.
decay: the rate at which viscosity damps u_r = -m J1(k r) cos(m z), u_z = k J0(k r) sin(m z) between walls that slip.
thread: the rate at which waves on a thread grow, S. Chandrasekhar, Hydrodynamic and Hydromagnetic Stability, 1961,
    section 111; without viscosity it is Rayleigh's.
swing: the frequency of a drop's second mode, H. Lamb, Hydrodynamics, 6th ed., 1932, section 275.
sphere: a drop that comes to rest, and its pressure.
cap: the contact angle of a drop that spreads on a floor.

summary.json   figures of all runs

python -m tipfem demo validation/round --flow thread
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, curve_fit
from scipy.special import iv, ivp, j0, j1, jn_zeros
from tipfem.demos import harness
from tipfem.demos.support.options import Arch, Several

import tipfem as tp
from tipfem.physics.surface_tension.edges import TensionEdges

Array = NDArray[np.float64]

WATER, AIR = tp.Fluid("water", density=998.2, viscosity=1e-3), tp.Fluid("air", density=1.2, viscosity=1.8e-5)
R = 0.4  # of the drops, whose density and tension are 1
LARGEST = {"speed": 1e-11, "volume": 1e-12, "rate": 5e-3, "frequency": 5e-3, "laplace": 5e-3, "capillary": 1e-4}
LARGEST |= {"angle": 0.5, "damping": 0.012}


def round_tank(size: tuple[float, float], spacing: float, jitter: float = 0.0) -> tp.case.tank.Tank:
    """A round tank whose walls slip."""
    tank = tp.tank(size, spacing, jitter=jitter, coordinates="axisymmetric")
    for side in ("right", "top", "bottom"):
        tank.wall(side, slip=True)
    return tank


def drop(across: float, liquid: tp.Fluid, around: tp.Fluid, size: tuple[float, float], **options: Any) -> tp.Simulation:
    """A drop of the radius R in the middle of the axis.

    Args:
        across: spacings in the diameter.
        liquid: of the drop.
        around: of what is around it.
        size: of the tank [m].
        options: ``swing``: amplitude of the second mode; ``jitter``, ``gravity``; and those of `tp.Case`.
    """
    middle, swing = size[1] / 2, options.pop("swing", 0.0)

    def inside(x: Array) -> Array:
        s = np.hypot(x[:, 0], x[:, 1] - middle)
        c = (x[:, 1] - middle) / np.maximum(s, 1e-30)
        return np.asarray(s < R * (1 - swing**2 / 5) * (1 + swing * (3 * c * c - 1) / 2))

    tank, gravity = round_tank(size, 2 * R / across, options.pop("jitter", 0.0)), options.pop("gravity", 0.0)
    tank.fill(around).fill(liquid, **({"where": inside} if swing else {"disc": ((0.0, middle), R)}))
    tension = {(liquid.name, around.name): 1.0}
    return tp.Simulation(tp.Case(tank, [liquid, around], (0, -gravity), surface_tension=tension, **options))


def interface(simulation: tp.Simulation) -> tuple[Array, Array]:
    """Both ends (E, 2) of the edges of the interface [m]."""
    edges, x = simulation.state.part(TensionEdges), simulation.particles.position
    return x[edges.one], x[edges.other]


def pair(viscosity: float, ratio: float) -> tuple[tp.Fluid, tp.Fluid]:
    """A liquid of density 1, and what is around it."""
    return tp.Fluid("liquid", 1.0, viscosity), tp.Fluid("around", ratio, ratio * viscosity)


def followed(simulation: tp.Simulation, end: float, measure: Callable[[], float]) -> tuple[Array, float]:
    """Times and values (K,) of a measure until the end, and the largest change of the liquid's volume, relative."""
    volume, course, worst = simulation.volume("liquid"), [(simulation.time, measure())], 0.0
    while simulation.time < end:
        simulation.step()
        course.append((simulation.time, measure()))
        worst = max(worst, abs(simulation.volume("liquid") / volume - 1))
    return np.array(course).T, worst


def rest(law: str, spacing: float = 0.1, steps: int = 10) -> dict[str, float]:
    """Speed [m/s] and error of the volume of two layers, on a mesh with a jitter of 0.2 spacings."""
    tank = tp.tank((0.5, 1.0), spacing, jitter=0.2, coordinates="axisymmetric")
    tank.fill(AIR).fill(WATER, box=((0, 0), (0.5, 0.6)))
    for side in ("right", "top", "bottom"):
        tank.wall(side, **({"slip": True} if law == "slip" else {"law": law}))
    simulation = tp.Simulation(tp.Case(tank, [WATER, AIR], (0, -9.81)))
    for _ in range(steps):
        simulation.step()
    volume = abs(simulation.volume("water") / (math.pi * 0.25 * 0.6) - 1)
    return {"speed": max(row["max_speed"] for row in simulation.history), "volume": volume}


def decay(across: int, steps: int = 60) -> dict[str, float]:
    """Error of the rate nu (k^2 + m^2) of a vortex ring in a cylinder of radius and height 1, with J1(k) = 0."""
    k, m, nu = float(jn_zeros(1, 1)[0]), math.pi, 1.0
    fluid = tp.Fluid("fluid", density=1.0, viscosity=nu)

    def start(x: Array) -> Array:
        (r, z), size = x.T, 1e-4
        return size * np.stack([-m * j1(k * r) * np.cos(m * z), k * j0(k * r) * np.sin(m * z)], axis=1)

    tank = round_tank((1.0, 1.0), 1 / across, jitter=0.2).fill(fluid, velocity=start)
    end = 1 / (nu * (k * k + m * m))
    simulation = tp.Simulation(tp.Case(tank, [fluid], (0, 0)), time_step=end / steps)
    simulation.step()  # the start is made free of divergence in it
    begun = simulation.time, simulation.energy().kinetic
    while simulation.time < end:
        simulation.step()
    rate = -math.log(simulation.energy().kinetic / begun[1]) / (2 * (simulation.time - begun[0]))
    return {"damping": rate * end - 1, "volume": abs(simulation.volume("fluid") / math.pi - 1)}


def growth(x: float, oh: float) -> float:
    """Rate at which a wave with k R = x grows on a thread of the Ohnesorge number ``oh``."""

    def off(w: float) -> float:
        y = math.sqrt(x * x + w / oh)
        more = 2 * oh * x * x / iv(0, x) * (ivp(1, x) - 2 * x * y / (x * x + y * y) * iv(1, x) / iv(1, y) * ivp(1, y))
        return float(w * w + more * w - x * (1 - x * x) * iv(1, x) / iv(0, x) * (y * y - x * x) / (y * y + x * x))

    return float(brentq(off, 1e-6, 1.0))


def thread(x: float, across: int = 6, oh: float = 1e-3) -> dict[str, float]:
    """Error of the rate of a wave with k R = x, with ``across`` spacings in the radius."""
    eps, height, wanted = 0.01, math.pi / x, growth(x, oh)
    liquid, around = pair(oh, 1e-3)
    tank = round_tank((3.0, height), 1 / across).fill(around)
    tank.fill(liquid, where=lambda p: p[:, 0] < 1 + eps * np.cos(x * p[:, 1]))
    simulation = tp.Simulation(tp.Case(tank, [liquid, around], (0, 0), surface_tension={("liquid", "around"): 1.0}))

    def amplitude() -> float:
        p, q = interface(simulation)
        m = (p + q) / 2
        return float((m[:, 0] - 1) @ (np.cos(x * m[:, 1]) * np.abs(p - q)[:, 1])) * 2 / height

    course, volume = followed(simulation, 2.5 / wanted, amplitude)

    def both(t: Array, b: float, c: float, w: float, d: float) -> Array:
        return np.asarray(b * np.exp(w * t) + c * np.exp(-d * t))

    rate = curve_fit(both, *course, [eps / 2, eps / 2, wanted, wanted])[0][2]
    return {"rate": float(rate) / wanted - 1, "volume": volume}


def swing(across: int = 8) -> dict[str, float]:
    """Error of the frequency of a drop's second mode, with ``across`` spacings in the diameter."""
    liquid, around = pair(math.sqrt(2 * R / 1e6), 1e-3)
    omega = math.sqrt(24 / ((3 + 2e-3) * R**3))
    numerics = tp.Numerics(mass="consistent")
    simulation = drop(across, liquid, around, (1.0, 2.0), swing=0.05, jitter=0.15, numerics=numerics)
    simulation.control.largest = 2 * math.pi / omega / 200

    def mode() -> float:
        a, b = (x - (0.0, 1.0) for x in interface(simulation))
        turned = np.abs(a[:, 1] / np.hypot(*a.T) - b[:, 1] / np.hypot(*b.T))
        r, x = (np.hypot(*a.T) + np.hypot(*b.T)) / 2, (a + b) / 2
        return 2.5 / R * float((r * (3 * (x[:, 1] / np.hypot(*x.T)) ** 2 - 1) / 2) @ turned)

    course, volume = followed(simulation, 4 * math.pi / omega, mode)

    def damped(t: Array, a: float, w: float, g: float, p: float, c: float) -> Array:
        return np.asarray(a * np.exp(-g * t) * np.cos(w * t + p) + c)

    found = curve_fit(damped, *course, [0.05, omega, 0.0, 0.0, 0.0])[0]
    return {"frequency": float(found[1]) / omega - 1, "volume": volume}


def sphere(across: int = 8, steps: int = 200) -> dict[str, float]:
    """Capillary number of a drop at rest, and the error of its pressure."""
    mu = math.sqrt(2 * R / 120)
    simulation = drop(across, *pair(mu, 0.1), (2.5 * R, 5 * R))
    volume = simulation.volume("liquid")
    for _ in range(steps):
        simulation.step()
    jump = np.abs(np.asarray(simulation.pressure_jump)).max(axis=0)
    jump = jump[jump > 0] / 2 * (3 * volume / (4 * math.pi)) ** (1 / 3)
    return {
        "capillary": mu * simulation.particles.max_speed,
        "laplace": float(jump.mean()) - 1,
        "spread": float(np.ptp(jump)),
        "volume": abs(simulation.volume("liquid") / volume - 1),
    }


def cap(angle: float, across: int = 8, steps: int = 500) -> dict[str, float]:
    """Error of the contact angle [degrees] of a half sphere that has spread, or drawn back, on a floor that slips."""
    liquid, around = pair(math.sqrt(2 * R / 120), 0.1)
    tank = tp.tank((1.6, 1.2), R / across, coordinates="axisymmetric").fill(around)
    tank.fill(liquid, disc=((0.0, 0.0), R)).wall("bottom", slip=True, contact_angle={("liquid", "around"): angle})
    tank.wall("right", slip=True).wall("top", slip=True)
    case = tp.Case(tank, [liquid, around], (0, 0), surface_tension={("liquid", "around"): 1.0})
    simulation = tp.Simulation(case, probes=[tp.DropProbe(name="drop", fluid="liquid")])
    volume = simulation.volume("liquid")
    for _ in range(steps):
        simulation.step()
    found = float(simulation.probes["drop"]["contact_angle"][-1])
    return {"angle": found - angle, "volume": abs(simulation.volume("liquid") / volume - 1)}


RUNS: dict[str, dict[str, Callable[[], dict[str, float]]]] = {
    "rest": {law: lambda law=law: rest(law) for law in ("layer", "no-slip", "slip")},  # type: ignore[misc]
    "decay": {f"R = {n} h": lambda n=n: decay(n) for n in (10, 20)},  # type: ignore[misc]
    "thread": {f"kR = {x:g}": lambda x=x: thread(x) for x in (0.3, 0.5, 0.7, 0.9)},  # type: ignore[misc]
    "swing": {f"D = {n} h": lambda n=n: swing(n) for n in (8, 16)},  # type: ignore[misc]
    "sphere": {f"D = {n} h": lambda n=n: sphere(n, 300) for n in (8, 16)},  # type: ignore[misc]
    "cap": {f"{angle:g} degrees": lambda angle=angle: cap(angle) for angle in (60.0, 120.0)},  # type: ignore[misc]
}


FLOWS = ("rest", "decay", "thread", "swing", "sphere", "cap")


def check(name: str, figures: dict[str, float]) -> list[str]:
    """What a run misses of what is expected; an empty list when all is well."""
    found = {key: abs(value) for key, value in figures.items() if key in LARGEST}
    return [f"{name}: {key} {value:.1e}" for key, value in found.items() if not value <= LARGEST[key]]


def main(
    *,
    flow: Several[Literal["rest", "decay", "thread", "swing", "sphere", "cap"]] = FLOWS,
    arch: Arch = "cpu",
    out: Path = Path("out/validation/round"),
) -> int:
    """Run the flows.

    Args:
        flow: which flows.
        arch: where the kernels run.
        out: folder for the results.
    """
    tp.init(arch=arch)
    out.mkdir(parents=True, exist_ok=True)
    summary: dict[str, dict[str, Any]] = {}
    for name in flow:
        summary[name] = {}
        for what, run in RUNS[name].items():
            summary[name][what] = run()
            print(name, what, {key: f"{value:.2e}" for key, value in summary[name][what].items()}, flush=True)
    missed = [text for name, runs in summary.items() for what, run in runs.items() for text in check(what, run)]
    return harness.report(out, summary, missed)


if __name__ == "__main__":
    harness.command(__name__)
