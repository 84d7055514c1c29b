"""Drops and menisci at rest: they stay there, and they come there."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tipfem.demos.validation.drops import theory

import tipfem as tp
from tipfem.physics.bodies.motion import BodyStates
from tipfem.physics.surface_tension.edges import TensionEdges

Array = NDArray[np.float64]

RADIUS = 0.4  # [m]; tension and the drop's density are 1
LAPLACE = 12000.0  # sigma rho D / mu^2 of the drop that stays at rest
OHNESORGE = 0.3  # mu / sqrt(rho sigma R) of those that come to rest
HOLDING = 70.0, 110.0  # angles at which the contacts of a drop on an incline recede and advance [degrees]
FALLEN = 2.5  # depth of the centre of a drop that drips [m]
BOND = 1.0  # rho g R^2 / sigma of the meniscus, R half the gap
LENS = {"water": 1.0, "oil": 0.6, ("water", "oil"): 0.7}  # tensions of a lens of oil, the first two with what is above


def simulated(tank: tp.Tank, fluids: list[tp.Fluid], gravity: float = 0.0, **options: Any) -> tp.Simulation:
    """A simulation with the tension 1 N/m between two fluids."""
    tension = {(fluids[0].name, fluids[1].name): 1.0}
    return tp.Simulation(tp.Case(tank, fluids, (0, -gravity), surface_tension=tension, **options))


def pair(ratio: float, viscosity: float) -> list[tp.Fluid]:
    """A liquid of density 1, and what is around it, of the density ``ratio`` and the same kinematic viscosity."""
    return [tp.Fluid("liquid", 1.0, viscosity), tp.Fluid("around", ratio, ratio * viscosity)]


def interface(simulation: tp.Simulation) -> tuple[Array, Array]:
    """The two ends (E, 2) of the edges of the interface [m]."""
    edges, x = simulation.state.part(TensionEdges), simulation.particles.position
    return x[edges.one], x[edges.other]


def static(ratio: float, across: int = 8, steps: int = 1000) -> dict[str, float]:
    """A round drop at rest: largest capillary number mu u / sigma of all steps, jump of the pressure, volume.

    Args:
        ratio: density around the drop, over its own.
        across: spacings in its diameter.
        steps: of the capillary time.
    """
    viscosity, size = math.sqrt(2 * RADIUS / LAPLACE), 5 * RADIUS
    fluids = pair(ratio, viscosity)
    tank = tp.tank((size, size), 2 * RADIUS / across).fill(fluids[1])
    simulation = simulated(tank.fill(fluids[0], disc=((size / 2, size / 2), RADIUS)), fluids)
    fastest, volume, iterations = 0.0, simulation.volume("liquid"), 0.0
    for _ in range(steps):
        simulation.step()
        fastest = max(fastest, simulation.particles.max_speed)
        iterations += simulation.history[-1]["krylov_iterations"]
    nodes = np.unique(simulation.state.part(TensionEdges).one)
    jump = np.abs(np.asarray(simulation.pressure_jump)[:, nodes]).max(axis=0).mean()
    return {
        "capillary_number": viscosity * fastest * max(ratio, 1.0),
        "jump": float(jump) * RADIUS - 1,
        "jump_of_polygon": 1 / math.cos(math.pi / len(nodes)) - 1,
        "volume": abs(simulation.volume("liquid") / volume - 1),
        "krylov_iterations": iterations / steps,
    }


def sessile(angle: float, wall: str, across: int = 16, steps: int = 800) -> dict[str, float]:
    """A half disc on a floor that is let go: radius and angle of the circle through its interface at rest.

    Args:
        angle: of the contacts [degrees].
        wall: law of the floor, "slip", "layer" or "no-slip".
        across: spacings in the diameter at the start.
        steps: of the capillary time.
    """
    fluids, spacing = pair(0.1, OHNESORGE * math.sqrt(RADIUS)), 2 * RADIUS / across
    tank = tp.tank((6 * RADIUS, 3 * RADIUS), spacing, jitter=0.15).fill(fluids[1])
    tank.fill(fluids[0], disc=((3 * RADIUS, 0.0), RADIUS))
    law = {"slip": True} if wall == "slip" else {"law": wall}
    tank.wall("bottom", contact_angle={("liquid", "around"): angle}, **law)
    simulation = simulated(tank, fluids)
    for _ in range(steps):
        simulation.step()
    middle, radius = _circle(np.concatenate(interface(simulation)))
    wanted = theory.sessile_radius(simulation.volume("liquid"), math.radians(angle))
    return {"radius": radius / wanted - 1, "angle": math.degrees(math.acos(-middle[1] / radius)) - angle}


def spreading(law: str, half: int, angle: float = 60.0) -> dict[str, float]:
    """A half disc on a floor that is let go: the speed of its contacts depends on the spacing.

    Args:
        law: of the floor, "no-slip", or "slip" for a slip length of a tenth of the radius.
        half: spacings in the radius.
        angle: of the contacts [degrees].

    Returns:
        speed: mean capillary number of a contact while the width grows from 1.1 to 1.22 of that at the start.
    """
    viscosity = math.sqrt(RADIUS)
    fluids, size = pair(0.1, viscosity), (5 * RADIUS, 2.5 * RADIUS)
    tank = tp.tank(size, RADIUS / half, jitter=0.1).fill(fluids[1]).fill(fluids[0], disc=((size[0] / 2, 0.0), RADIUS))
    given = {"slip_length": 0.1 * RADIUS} if law == "slip" else {"law": law}
    tank.wall("bottom", contact_angle={("liquid", "around"): angle}, **given)
    simulation, course = simulated(tank, fluids), [(0.0, 1.0)]
    while course[-1][1] < 1.22:
        simulation.step()
        course.append((simulation.time, float(np.ptp(_on_floor(simulation))) / (2 * RADIUS)))
    times, width = np.array(course).T
    first, last = np.interp([1.1, 1.22], width, times)
    return {"speed": viscosity * 0.12 * RADIUS / float(last - first)}


def meniscus(angle: float, half: int = 8, steps: int = 800) -> dict[str, float]:
    """A liquid between two plates that slip: height of its contacts above the middle.

    Args:
        angle: of the contacts [degrees].
        half: spacings in half the gap.
        steps: of the largest step.
    """
    fluids, ratio = pair(0.01, OHNESORGE * math.sqrt(RADIUS)), 0.01
    gravity = BOND / ((1 - ratio) * RADIUS**2)
    tank = tp.tank((2 * RADIUS, 4 * RADIUS), RADIUS / half, jitter=0.1).fill(fluids[1])
    tank.fill(fluids[0], box=((0, 0), (2 * RADIUS, 2 * RADIUS)))
    for side in ("left", "right"):
        tank.wall(side, slip=True, contact_angle={("liquid", "around"): angle})
    simulation = simulated(tank, fluids, gravity)
    for _ in range(steps):
        simulation.step()
    x = np.concatenate(interface(simulation))
    x = x[np.argsort(x[:, 0])]
    height = 0.5 * (x[0, 1] + x[-1, 1]) - np.interp(RADIUS, x[:, 0], x[:, 1])
    length = RADIUS / math.sqrt(BOND)
    return {"height": float(height) / theory.meniscus(RADIUS, length, math.radians(angle)) - 1}


def hanging(part: float, across: int = 8, end: float = 25.0) -> dict[str, float]:
    """A drop under a ceiling that slips, let go as a half disc, with contacts at 90 degrees: whether it hangs or drips.

    Args:
        part: its area over that of the largest drop that hangs.
        across: spacings in sqrt(sigma / (rho g)), which is 1 m.
        end: of the run [s].

    Returns:
        depth: of its centre below the ceiling at the end [m].
        wrong: 1 where it hangs and theory says that it drips, or the other way round; else 0.
    """
    width, height, ratio = 8.0, 6.0, 0.01
    fluids, radius = pair(ratio, 1.0), math.sqrt(2 * part * theory.largest_hanging_drop() / math.pi)
    tank = tp.tank((width, height), 1 / across, jitter=0.1).fill(fluids[1])
    tank.fill(fluids[0], disc=((width / 2, height), radius))
    tank.wall("top", slip=True, contact_angle={("liquid", "around"): 90})
    grading = tp.Grading({"around": 4 / across})
    simulation = simulated(tank, fluids, 1 / (1 - ratio), grading=grading)
    probe, depth = tp.DropProbe(name="drop", fluid="liquid"), 0.0
    while simulation.time < end and depth < FALLEN:
        simulation.step()
        depth = height - probe.sample(simulation)[2]
    return {"depth": depth, "wrong": float((depth >= FALLEN) != (part > 1))}


def incline(part: float, across: int = 10, end: float = 6.0) -> dict[str, float]:
    """A half disc on a floor that slips, with the angles `HOLDING`, under a force along the floor: whether it slides.

    It is held up to the acceleration sigma (cos(receding) - cos(advancing)) / ((rho_1 - rho_2) area).

    Args:
        part: the acceleration over that one; it grows in the first half of the run.
        across: spacings in the drop's diameter.
        end: of the run [s].

    Returns:
        moved: what the slower contact has moved [spacings].
        wrong: 1 where it is held and theory says that it slides, or the other way round; else 0.
    """
    ratio, largest = 0.1, [0.0]
    fluids, spacing = pair(ratio, OHNESORGE * math.sqrt(RADIUS)), 2 * RADIUS / across
    tank = tp.tank((4 * RADIUS, 2.4 * RADIUS), spacing, jitter=0.12).fill(fluids[1])
    tank.fill(fluids[0], disc=((2 * RADIUS, 0.0), RADIUS))
    tank.wall("bottom", slip=True, contact_angle={("liquid", "around"): HOLDING})

    def push(x: Array, t: float) -> Array:
        return np.tile([largest[0] * min(2 * t / end, 1.0), 0.0], (len(x), 1))

    simulation = simulated(tank, fluids, body_force=push)
    receding, advancing = (math.cos(math.radians(angle)) for angle in HOLDING)
    largest[0] = part * (receding - advancing) / ((1 - ratio) * simulation.volume("liquid"))
    start = _on_floor(simulation)
    while simulation.time < end:
        simulation.step()
    moved = float((_on_floor(simulation) - start).min()) / spacing
    return {"moved": moved, "wrong": float((moved > 0.2) != (part > 1))}


def lens(above: str, across: int = 10, end: float = 10.0) -> dict[str, float]:
    """A disc of oil, half of it in water, that spreads to a lens: its width, and the angles of Neumann's triangle.

    Args:
        above: name of what is above both fluids, "air" or "empty space".
        across: spacings in the diameter of the disc.
        end: of the run [s].

    Returns:
        width: relative error of the distance of the two contacts.
        upper, lower: errors of the angles of the circles through both arcs with the surface beside [degrees].
    """
    viscosity, size, level = OHNESORGE * math.sqrt(RADIUS), 8 * RADIUS, 2.5 * RADIUS
    fluids = [tp.Fluid(name, density, density * viscosity) for name, density in [("water", 1.0), ("oil", 0.8)]]
    tank = tp.tank((size, 5 * RADIUS), 2 * RADIUS / across, jitter=0.1)
    tensions: dict[Any, float] = dict(LENS)
    if above == "air":
        fluids.append(tp.Fluid("air", 0.01, 0.01 * viscosity))
        tank.fill(fluids[2])
        tensions = {(pair, "air") if isinstance(pair, str) else pair: value for pair, value in LENS.items()}
    tank.fill(fluids[0], box=((0, 0), (size, level))).fill(fluids[1], disc=((size / 2, level), RADIUS))
    case = tp.Case(slippery(tank), fluids, (0, 0), free_surface=above != "air", surface_tension=tensions)
    simulation = tp.Simulation(case)
    while simulation.time < end:
        simulation.step()
    edges, x = simulation.state.part(TensionEdges), simulation.particles.position
    assert edges is not None
    upper, lower = ({*edges.one[edges.sigma == each], *edges.other[edges.sigma == each]} for each in (0.6, 0.7))
    contacts = x[sorted(upper & lower)]
    half, found = 0.5 * float(np.ptp(contacts[:, 0])), []
    for arc, out in ((upper, 1), (lower, -1)):
        middle, radius = _circle(x[sorted(arc)])
        found.append(math.degrees(math.acos(out * (contacts[:, 1].mean() - middle[1]) / radius)))
    wanted, *angles = theory.lens(simulation.volume("oil"), *LENS.values())
    upper_error, lower_error = (one - math.degrees(other) for one, other in zip(found, angles, strict=True))
    return {"width": half / wanted - 1, "upper": upper_error, "lower": lower_error}


def slippery(tank: tp.Tank) -> tp.Tank:
    """The tank, with sides on which fluids slip."""
    for side in ("left", "right", "bottom", "top"):
        tank.wall(side, slip=True)
    return tank


def _circle(x: Array) -> tuple[Array, float]:
    """Centre (2,) and radius of the circle through points (K, 2), by least squares of |x|^2 [m]."""
    unknown = np.linalg.lstsq(np.column_stack([2 * x, np.ones(len(x))]), (x**2).sum(axis=1), rcond=None)[0]
    return unknown[:2], math.sqrt(unknown[2] + unknown[:2] @ unknown[:2])


def floating(angle: float, density: float, law: str, across: int = 10, end: float = 18.0) -> dict[str, float]:
    """A disc that floats where interfaces meet it at an angle: height of its centre above the level far from it.

    Its radius is sqrt(sigma / (rho g)), 1 m, with the difference of the densities. It moves up and down.

    Args:
        angle: of the contacts, through the liquid [degrees].
        density: of the disc, over the liquid's.
        law: of its outline, "slip" or "no-slip".
        across: spacings in its diameter.
        end: of the run [s].

    Returns:
        height, contact: error of the heights of its centre and of the contacts [radii].
    """
    width, height, level, ratio = 12.0, 7.0, 3.5, 0.01
    fluids, gravity = pair(ratio, OHNESORGE), 1 / (1 - ratio)
    tank = tp.tank((width, height), 2 / across).fill(fluids[1]).fill(fluids[0], box=((0, 0), (width, level)))
    for side in ("left", "right"):
        tank.wall(side, slip=True)
    wanted, contact = theory.floating_disc(1.0, math.radians(angle), (density - ratio) * gravity * math.pi)
    outline = {"slip": True} if law == "slip" else {"law": law}
    disc = tp.shapes.circle((width / 2, level + wanted + 0.3), 1.0)
    kept = {"free": ("y",), "damping": (0, 2.0, 0), "contact_angle": {("liquid", "around"): angle}}
    tank.add(tp.Body(disc, name="disc", density=density, **kept, **outline))
    simulation = simulated(tank, fluids, gravity)
    while simulation.time < end:
        simulation.step()
    far, here = _levels(simulation)
    return {"height": simulation.history[-1]["disc_y"] - far - wanted, "contact": here - far - contact}


def plate(angle: float, law: str, half: int = 8, end: float = 18.0) -> dict[str, float]:
    """A fixed plate that stands in a liquid: the force on it by tension, 2 sigma cos(angle) downwards; its meniscus.

    Args:
        angle: of the contacts, through the liquid [degrees].
        law: of the plate, "slip" or "no-slip".
        half: spacings in sqrt(sigma / (rho g)), which is 1 m.
        end: of the run [s].

    Returns:
        force: error over 2 sigma.
        contact: error of the contacts' height above the level far from the plate [m].
    """
    width, height, level, ratio, wide, deep = 9.0, 6.0, 3.0, 0.01, 1.0, 1.5
    fluids, gravity = pair(ratio, OHNESORGE), 1 / (1 - ratio)
    tank = tp.tank((width, height), 1 / half).fill(fluids[1]).fill(fluids[0], box=((0, 0), (width, level)))
    for side in ("left", "right"):
        tank.wall(side, slip=True)
    outline = {"slip": True} if law == "slip" else {"law": law}
    shape = tp.shapes.rectangle(((width - wide) / 2, level - deep), ((width + wide) / 2, level + deep))
    tank.add(tp.Body(shape, name="plate", contact_angle={("liquid", "around"): angle}, **outline))
    simulation = simulated(tank, fluids, gravity)
    while simulation.time < end:
        simulation.step()
    far, here = _levels(simulation)
    cosine = math.cos(math.radians(angle))
    climbs = math.copysign(math.sqrt(2 - 2 * math.sqrt(1 - cosine**2)), cosine)
    floats = wide * (far - level + deep) + ratio * gravity * 2 * wide * deep
    force = simulation.history[-1]["plate_force_y"]
    return {"force": (force - floats) / 2 + cosine, "contact": here - far - climbs}


def _levels(simulation: tp.Simulation) -> tuple[float, float]:
    """Mean heights of the interface's ends on the sides of the tank, and on the body in it [m]."""
    edges, particles = simulation.state.part(TensionEdges), simulation.particles
    ends = np.unique(np.concatenate([edges.one, edges.other]))
    ends = ends[particles.wall[ends]]
    on = simulation.state.part(BodyStates).label[ends] >= 0
    y = particles.position[ends, 1]
    return float(y[~on].mean()), float(y[on].mean())


def _on_floor(simulation: tp.Simulation) -> Array:
    """The two ends of the interface on the floor, from the left [m]."""
    x = np.unique(np.concatenate(interface(simulation)), axis=0)
    return np.asarray(np.sort(x[x[:, 1] == 0.0, 0])[[0, -1]])


def rise(angle: float, half: int = 4, end: float = 22.0) -> dict[str, float]:
    """A liquid in two arms, one three times as wide as the other: difference of the mean heights.

    By the balance of forces on what stands in an arm of the half width R, sigma cos(angle) / (rho g R) each.

    Args:
        angle: of the contacts on all sides of the arms [degrees].
        half: spacings in half the narrow arm.
        end: of the run [s], some four times as long as it takes to rise.
    """
    narrow, plate, low, high = RADIUS, RADIUS, 1.2 * RADIUS, 6 * RADIUS
    fluids, ratio, left = pair(0.01, OHNESORGE * math.sqrt(RADIUS)), 0.01, 2 * narrow
    gravity = BOND / ((1 - ratio) * RADIUS**2)
    width = left + plate + 6 * narrow
    shape = tp.shapes.polygon(
        [(0, 0), (width, 0), (width, high + low), (0, high + low)],
        names=["floor", "right", "lid", "left"],
        holes=[tp.shapes.rectangle((left, low), (left + plate, high), names=["plate"] * 4)],
    )
    tank = tp.tank(shape=shape, spacing=narrow / half).fill(fluids[1])
    wanted = math.cos(math.radians(angle)) * (1 / narrow - 1 / (3 * narrow)) / (gravity * (1 - ratio))
    tank.fill(fluids[0], box=((0, 0), (width, 3 * RADIUS)))
    for side in ("left", "right", "plate", "floor"):
        given = {} if side == "floor" else {"contact_angle": {("liquid", "around"): angle}}
        tank.wall(side, law="no-slip", **given)
    simulation = simulated(tank, fluids, gravity)
    while simulation.time < end:
        simulation.step()
    one, other = interface(simulation)
    middle, along = 0.5 * (one + other), np.abs(one - other)[:, 0]
    means = [middle[here, 1] @ along[here] / along[here].sum() for here in (middle[:, 0] < left, middle[:, 0] > left)]
    return {"height": float(means[0] - means[1]) / wanted - 1, "speed": simulation.particles.max_speed}
