"""Axisymmetric flows against theory.

rest: layers of water and air on a jittered mesh, with each law of walls.
decay: the rate at which viscosity damps u_r = -m J1(k r) cos(m z), u_z = k J0(k r) sin(m z) between walls that slip.
thread: the rate at which waves on a thread grow, S. Chandrasekhar, Hydrodynamic and Hydromagnetic Stability, 1961,
    section 111; without viscosity it is Rayleigh's.
swing: the frequency of a drop's second mode, H. Lamb, Hydrodynamics, 6th ed., 1932, section 275.
sphere: a drop that comes to rest, and its pressure.
cap: the contact angle of a drop that spreads on a floor.
tube: how far tension lifts a liquid in a tube, 2 sigma cos(angle) / (rho g R).
pipe: the fall of the pressure of Poiseuille's flow in a pipe, 8 mu U / R^2.
bubble: the Reynolds number of bubbles that rise, against D. Bhaga & M. E. Weber, 1981 (see bubbles.py).
impact: how wide drops become that hit a floor, over their diameter, against L. E. Scheller & D. W. Bousfield, AIChE
    Journal 41, 1995, whose fit of measurements is 0.61 (Re^2 Oh)^0.166.

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
from tipfem.demos.validation.round.bubbles import bubble

import tipfem as tp
from tipfem.physics.surface_tension.edges import TensionEdges

Array = NDArray[np.float64]

WATER, AIR = tp.Fluid("water", density=998.2, viscosity=1e-3), tp.Fluid("air", density=1.2, viscosity=1.8e-5)
R = 0.4  # of the drops, whose density and tension are 1
GROWN = 0.03  # amplitude to which waves on threads grow [radii]
LARGEST = {"speed": 1e-11, "volume": 1e-12, "rate": 5e-3, "frequency": 5e-3, "laplace": 1e-4, "capillary": 1e-6}
LARGEST |= {
    "angle": 0.5,
    "lumped": 0.025,
    "damping": 0.012,
    "rise": 2e-3,
    "gradient": 1e-3,
    "coarse": 2e-3,
    "reynolds": 0.05,
    "wider": 0.15,
}


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


def thread(x: float, across: int = 6, oh: float = 1e-3, empty: bool = False) -> dict[str, float]:
    """Error of the rate of a wave with k R = x, with ``across`` spacings in the radius, in a gas or in empty space.

    From rest it grows to `GROWN` radii: beside k R = 1 the rates of larger waves are others, by 6 % at 0.1 radii.
    """
    height, wanted, liquid, around = math.pi / x, growth(x, oh), *pair(oh, 1e-3)
    decay = wanted + 3 * oh * x * x
    eps = GROWN * math.exp(-2.5) * (wanted + decay) / decay
    if empty:
        z = np.linspace(0.0, height, 41)
        surface = np.stack([1 + eps * np.cos(x * z), z], axis=1).tolist()
        tank = round_tank((1.5, height), 1 / across).fill(liquid, shape=[(0.0, 0.0), *surface, (0.0, height)])
        case = tp.Case(tank, [liquid], (0, 0), free_surface=True, surface_tension={"liquid": 1.0})
    else:
        tank = round_tank((3.0, height), 1 / across).fill(around)
        tank.fill(liquid, where=lambda p: p[:, 0] < 1 + eps * np.cos(x * p[:, 1]))
        case = tp.Case(tank, [liquid, around], (0, 0), surface_tension={("liquid", "around"): 1.0})
    simulation = tp.Simulation(case)

    def amplitude() -> float:
        p, q = interface(simulation)
        m = (p + q) / 2
        return float((m[:, 0] - 1) @ (np.cos(x * m[:, 1]) * np.abs(p - q)[:, 1])) * 2 / height

    course, volume = followed(simulation, 2.5 / wanted, amplitude)

    def both(t: Array, b: float, w: float, d: float) -> Array:
        return np.asarray(b * (np.exp(w * t) + w / d * np.exp(-d * t)))  # at rest at the start

    rate = curve_fit(both, *course, [eps * decay / (wanted + decay), wanted, decay])[0][1]
    return {"rate": float(rate) / wanted - 1, "volume": volume}


def swing(across: int = 8, mass: Literal["lumped", "consistent"] = "consistent") -> dict[str, float]:
    """Error of the frequency of a drop's second mode, with ``across`` spacings in the diameter."""
    liquid, around = pair(math.sqrt(2 * R / 1e6), 1e-3)
    numerics = tp.Numerics(mass=mass)
    simulation = drop(across, liquid, around, (1.0, 2.0), swing=0.02, jitter=0.15, numerics=numerics)
    cubed = 3 * simulation.volume("liquid") / (4 * math.pi)  # of the radius; edges are chords
    omega = math.sqrt(24 / ((3 + 2e-3) * cubed))
    simulation.control.largest = 2 * math.pi / omega / 200

    def mode() -> float:
        a, b = (x - (0.0, 1.0) for x in interface(simulation))
        turned = np.abs(a[:, 1] / np.hypot(*a.T) - b[:, 1] / np.hypot(*b.T))
        r, x = (np.hypot(*a.T) + np.hypot(*b.T)) / 2, (a + b) / 2
        return 2.5 / R * float((r * (3 * (x[:, 1] / np.hypot(*x.T)) ** 2 - 1) / 2) @ turned)

    course, volume = followed(simulation, 4 * math.pi / omega, mode)

    def damped(t: Array, a: float, w: float, g: float, p: float, c: float) -> Array:
        return np.asarray(a * np.exp(-g * t) * np.cos(w * t + p) + c)

    found = curve_fit(damped, *course, [0.02, omega, 0.0, 0.0, 0.0])[0]
    return {"frequency" if mass == "consistent" else mass: float(found[1]) / omega - 1, "volume": volume}


def sphere(across: int = 8, end: float = 2.0) -> dict[str, float]:
    """Capillary number of a drop at rest, and the error of its pressure."""
    mu = math.sqrt(2 * R / 120)
    simulation = drop(across, *pair(mu, 0.1), (2.5 * R, 5 * R))
    volume = simulation.volume("liquid")
    while simulation.time < end:
        simulation.step()
    jump = np.abs(np.asarray(simulation.pressure_jump)).max(axis=0)
    jump = jump[jump > 0] / 2 * (3 * volume / (4 * math.pi)) ** (1 / 3)
    return {
        "capillary": mu * simulation.particles.max_speed,
        "laplace": float(jump.mean()) - 1,
        "spread": float(np.ptp(jump)),
        "volume": abs(simulation.volume("liquid") / volume - 1),
    }


def cap(angle: float, across: int = 8, end: float = 4.0) -> dict[str, float]:
    """Error of the contact angle [degrees] of a half sphere that has spread, or drawn back, on a floor that slips."""
    liquid, around = pair(math.sqrt(2 * R / 120), 0.1)
    tank = tp.tank((1.6, 1.2), R / across, coordinates="axisymmetric").fill(around)
    tank.fill(liquid, disc=((0.0, 0.0), R)).wall("bottom", slip=True, contact_angle={("liquid", "around"): angle})
    tank.wall("right", slip=True).wall("top", slip=True)
    case = tp.Case(tank, [liquid, around], (0, 0), surface_tension={("liquid", "around"): 1.0})
    simulation = tp.Simulation(case, probes=[tp.DropProbe(name="drop", fluid="liquid")])
    volume = simulation.volume("liquid")
    while simulation.time < end:
        simulation.step()
    found = float(simulation.probes["drop"]["contact_angle"][-1])
    return {"angle": found - angle, "volume": abs(simulation.volume("liquid") / volume - 1)}


RUNS: dict[str, dict[str, Callable[[], dict[str, float]]]] = {
    "rest": {law: lambda law=law: rest(law) for law in ("layer", "no-slip", "slip")},  # type: ignore[misc]
    "decay": {f"R = {n} h": lambda n=n: decay(n) for n in (10, 20)},  # type: ignore[misc]
    "thread": {f"kR = {x:g}": lambda x=x: thread(x) for x in (0.3, 0.5, 0.7, 0.9)}  # type: ignore[misc]
    | {
        f"kR = {x:g}, Oh = {oh:g}": lambda x=x, oh=oh: thread(x, oh=oh, empty=True)  # type: ignore[misc]
        for oh, x in ((0.1, 0.3), (0.1, 0.6), (0.1, 0.9), (1.0, 0.3), (1.0, 0.6), (1.0, 0.9))
    },
    "swing": {f"D = {n} h": lambda n=n: swing(n) for n in (8, 16)}  # type: ignore[misc]
    | {f"D = {n} h, lumped": lambda n=n: swing(n, "lumped") for n in (8, 16)},  # type: ignore[misc]
    "sphere": {f"D = {n} h": lambda n=n: sphere(n, 6.0) for n in (8, 16)},  # type: ignore[misc]
    "cap": {f"{angle:g} degrees": lambda angle=angle: cap(angle) for angle in (60.0, 120.0)},  # type: ignore[misc]
    "tube": {f"{angle:g} degrees": lambda angle=angle: tube(angle) for angle in (30.0, 60.0)},  # type: ignore[misc]
    "pipe": {f"R = {n} h": lambda n=n: pipe(n) for n in (16, 24)},  # type: ignore[misc]
    "bubble": {f"Mo = {mo:g}": lambda mo=mo: bubble(mo) for mo in (848.0, 41.1, 5.51)},  # type: ignore[misc]
    "impact": {
        f"We = {we:g}, Oh = {oh:g}": lambda we=we, oh=oh: impact(we, oh)  # type: ignore[misc]
        for we in (10.0, 30.0, 100.0)
        for oh in (0.01, 0.03)
    },
}


Flow = Literal["rest", "decay", "thread", "swing", "sphere", "cap", "tube", "pipe", "bubble", "impact"]


def tube(angle: float, across: int = 8, end: float = 44.0) -> dict[str, float]:
    """Error of the height of a liquid in a tube of radius 1 m over that of the reservoir below it."""
    liquid, level, wanted = tp.Fluid("liquid", 1.0, 0.5), 1.0, 2 * math.cos(math.radians(angle))
    tank = tp.tank((1.0, level + wanted + 1.2), 1 / across, coordinates="axisymmetric")
    tank.fill(liquid, box=((0, 0), (1.0, level + 0.8 * wanted)))
    tank.wall("right", slip_length=0.3, contact_angle={"liquid": angle})  # its friction damps the swing
    below = [tp.Inlet(wall="bottom", fluid=liquid, level=level)]
    case = tp.Case(tank, [liquid], (0, -1), free_surface=True, surface_tension={"liquid": 1.0}, openings=below)
    simulation = tp.Simulation(case)
    while simulation.time < end:
        simulation.step()
    return {"rise": (simulation.volume("liquid") / math.pi - level) / wanted - 1}


def pipe(across: int, end: float = 0.3) -> dict[str, float]:
    """Errors of the pressure gradient of a flow that enters as Poiseuille's, and of its velocities, over the largest.

    Args:
        across: spacings in the radius of 1 m.
        end: of the run [s].
    """
    oil = tp.Fluid("oil", density=1.0, viscosity=1.0)

    def exact(x: Array) -> Array:
        return np.stack([0 * x[:, 0], 2 * (1 - x[:, 0] ** 2)], axis=1)

    tank = tp.tank((1.0, 2.0), 1 / across, jitter=0.1, coordinates="axisymmetric").fill(oil, velocity=exact)
    tank.wall("right", law="no-slip")
    inlet = tp.Inlet(wall="bottom", fluid=oil, velocity=1.0, profile="parabola")
    simulation = tp.Simulation(tp.Case(tank, [oil], (0, 0), openings=[inlet, tp.Outlet(wall="top")]))
    while simulation.time < end:
        simulation.step()
    particles = simulation.particles
    x, wrong = particles.position, particles.velocity - exact(particles.position)
    middle = abs(x[:, 1] - 1) < 0.5  # away from the openings
    gradient = float(np.polyfit(x[middle, 1], particles.pressure[middle], 1)[0])
    name = "gradient" if across > 20 else "coarse"
    return {name: gradient / -8.0 - 1, "profile": float(np.sqrt((wrong[:, 1] ** 2).mean())) / 2}


def impact(weber: float, oh: float, across: int = 24) -> dict[str, float]:
    """How wide a drop becomes on a no-slip floor that it meets at 90 degrees, and how far that is off the fit."""
    tension, spacing = 1 / weber, 1 / across
    liquid = tp.Fluid("liquid", density=1.0, viscosity=oh * math.sqrt(tension))
    tank = tp.tank((2.2, 1.3), spacing, coordinates="axisymmetric")
    tank.fill(liquid, disc=((0.0, 0.5 * (1 + spacing)), 0.5), velocity=(0.0, -1.0))
    tank.wall("bottom", law="no-slip", contact_angle={"liquid": 90})
    simulation = tp.Simulation(tp.Case(tank, [liquid], (0, 0), free_surface=True, surface_tension={"liquid": tension}))
    volume, widest, when = simulation.volume("liquid"), 0.0, 0.0
    while simulation.time < max(when + 0.3, 0.8):
        simulation.step()
        mesh = simulation.state.mesh
        width = 2 * float(mesh.position[mesh.used, 0].max())
        if width > widest:
            widest, when = width, simulation.time
    fit = 0.61 * (weber / oh) ** 0.166  # Re = sqrt(We) / Oh
    return {"width": widest, "wider": widest / fit - 1, "volume": abs(simulation.volume("liquid") / volume - 1)}


def check(name: str, figures: dict[str, float]) -> list[str]:
    """What a run misses of what is expected; an empty list when all is well."""
    found = {key: abs(value) for key, value in figures.items() if key in LARGEST}
    return [f"{name}: {key} {value:.1e}" for key, value in found.items() if not value <= LARGEST[key]]


def main(
    *,
    flow: Several[Flow] | None = None,
    arch: Arch = "cpu",
    out: Path = Path("out/validation/round"),
) -> int:
    """Run the flows.

    Args:
        flow: which flows; by default all.
        arch: where the kernels run.
        out: folder for the results.
    """
    tp.init(arch=arch)
    out.mkdir(parents=True, exist_ok=True)
    summary: dict[str, dict[str, Any]] = {}
    for name in flow or RUNS:
        summary[name] = {}
        for what, run in RUNS[name].items():
            summary[name][what] = run()
            print(name, what, {key: f"{value:.2e}" for key, value in summary[name][what].items()}, flush=True)
    missed = [text for name, runs in summary.items() for what, run in runs.items() for text in check(what, run)]
    return harness.report(out, summary, missed)


if __name__ == "__main__":
    harness.command(__name__)
