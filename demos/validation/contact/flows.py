"""The cases of the study of bodies that touch, and how far they are from what is known about them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.sparse import coo_matrix, diags
from scipy.sparse.linalg import splu
from tipfem.demos.support.histories import column, middle_of_water, zeros

import tipfem as tp
from tipfem.errors import Invalid
from tipfem.geometry.plane.touching import SKIN

Array = NDArray[np.float64]
Figures = dict[str, float]
Curves = tuple[str, dict[str, tuple[Array, Array]]] | None  # what is drawn; times [s] and values by name

G = 9.81  # [m/s^2]
FRICTION = 0.3
WATER = tp.Fluid("water", density=1000.0, viscosity=1e-3)
AIR = tp.Fluid("air", density=1.2, viscosity=1.8e-5)
OIL = tp.Fluid("oil", density=900.0, viscosity=1e-2)
rectangle = tp.shapes.rectangle

# A box under water, 0.4 m wide and 0.2 m high, in a tank of 1.2 m x 0.9 m.
WIDE, HIGH, DEPTH, HEAVY = 0.4, 0.2, 0.6, 2500.0
# A box that a dam break pushes: its place and its size [m], and its density.
PUSHED, CUBE, SOLID = 0.8, 0.12, 1500.0
# A flap in water: depth, place, distance of the gauge from it [m], period [s], angle.
POOL, FLAP, GAUGE, PERIOD, SWING = 0.5, 0.6, 1.6, 1.4, 0.06
SLOSHING = 0.3  # depth of water in a tank 1 m long, with a baffle half as high in its middle [m]


def advance(
    bodies: Sequence[tp.Body],
    spacing: float,
    end: float,
    *,
    size: tuple[float, float] = (2.4, 1.2),
    water: Any = ((0, 0), (0.3, 0.1)),
    fluids: Sequence[tp.Fluid] = (WATER,),
    gravity: tuple[float, float] = (0.0, -G),
    columns: dict[str, Callable[[tp.Simulation], float]] | None = None,
) -> tp.Simulation:
    """A simulation of bodies in a tank with some water under a free surface or another fluid, at its end [s]."""
    tank = tp.tank(size, spacing).fill(WATER, box=water)
    if len(fluids) > 1:
        tank.fill(fluids[1], box=((0, water[1][1]), size))
    for body in bodies:
        tank.add(body)
    simulation = tp.Simulation(tp.Case(tank, fluids, gravity, free_surface=True), columns=columns)
    while simulation.time < end * (1 - 1e-9):
        simulation.step(end)
    return simulation


def box(low: Any, high: Any, name: str = "box", density: float = 800.0, gap: Any = "seep", **options: Any) -> tp.Body:
    """A box that floats and may touch."""
    return tp.Body(rectangle(low, high), name=name, density=density, gap=gap, friction=FRICTION, **options)


def unbalanced(simulation: tp.Simulation) -> float:
    """The largest residual of the energy of a step [J/m]."""
    return float(np.abs(column(simulation, "energy_residual")).max())


def slope(short: bool) -> tuple[Figures, Curves]:
    """Boxes on dry slopes; the speed of those that slide is g (sin a - mu cos a) t."""
    speed = weight = 0.0
    for tangent in (0.29, 0.31) if short else (0.28, 0.299, 0.301, 0.35):
        angle = math.atan(tangent)
        gravity = G * math.sin(angle), -G * math.cos(angle)
        simulation = advance([box((1.0, 0), (1.3, 0.2))], 0.05, 0.1 if short else 0.2, gravity=gravity)
        time, along = column(simulation, "time"), max(0.0, gravity[0] + FRICTION * gravity[1])
        speed = max(speed, float(np.abs(column(simulation, "box_velocity_x") - along * time).max()))
        normal = column(simulation, "box_contact_force_y") / (-gravity[1] * 800.0 * 0.06)
        weight = max(weight, float(np.abs(normal - 1).max()))
    return {"speed": speed, "weight": weight}, None


def stack(short: bool) -> tuple[Figures, Curves]:
    """Two boxes, one on the other: each carries what is on it, and none moves."""
    low, up = box((1.0, 0), (1.4, 0.2), "low"), box((1.05, 0.2), (1.3, 0.35), "up", 1200.0)
    simulation = advance([low, up], 0.05, 0.05 if short else 0.3)
    weight = speed = 0.0
    for body in (low, up):
        carried = column(simulation, f"{body.name}_contact_force_y") / (body.total_mass * G)
        weight = max(weight, float(np.abs(carried - 1).max()))
        for name in ("velocity_x", "velocity_y", "angular_velocity"):
            speed = max(speed, float(np.abs(column(simulation, f"{body.name}_{name}")).max()))
    return {"weight": weight, "speed": speed}, None


def tumble(short: bool) -> tuple[Figures, Curves]:
    """A box that falls on its corner comes to rest on a side, and its energy never rises."""
    corners = 0.5 * np.array([[-WIDE, -HIGH], [WIDE, -HIGH], [WIDE, HIGH], [-WIDE, HIGH]])
    turned = corners @ np.array([[math.cos(0.4), math.sin(0.4)], [-math.sin(0.4), math.cos(0.4)]])
    turned += (1.4, (0.16 if short else 0.3) - turned[:, 1].min())
    simulation = advance(
        [tp.Body(turned, name="box", density=800.0, gap="seep", friction=0.5)], 0.05, 0.6 if short else 1.2
    )
    energy = column(simulation, "body_kinetic_energy") + column(simulation, "body_potential_energy")
    last = simulation.history[-1]
    return {
        "rise": float(np.diff(energy).max() / (energy[0] - energy[-1])),
        "height": last["box_y"] - 0.5 * HIGH - SKIN * 0.05,
        "angle": last["box_angle"] + 0.4,
        "energy": unbalanced(simulation),
    }, None


def bounce(short: bool) -> tuple[Figures, Curves]:
    """A ball that falls on a dry floor rises by e^2 of its fall."""
    figures: Figures = {"energy": 0.0}
    lines = {}
    for e in (0.8,) if short else (0.9, 0.8, 0.5):
        fall, radius = 0.5, 0.1
        ball = tp.shapes.circle((1.4, fall + radius + SKIN * 0.05), radius)
        time_down = math.sqrt(2 * fall / G)
        body = tp.Body(ball, name="ball", density=800.0, gap="seep", friction=FRICTION, restitution=e)
        simulation = advance([body], 0.05, time_down * (1 + 1.9 * e))
        time, height = column(simulation, "time"), column(simulation, "ball_y") - radius - SKIN * 0.05
        figures[f"rise {e}"] = float(height[time > 1.05 * time_down].max() / (e**2 * fall) - 1)
        figures["energy"] = max(figures["energy"], unbalanced(simulation))
        lines[f"e = {e}"] = time, height
    return figures, ("height [m]", lines)


def gate(short: bool) -> tuple[Figures, Curves]:
    """A closed gate with water behind it: at rest, and its force that of the water's weight."""
    depth, spacing = 0.3, 0.3 / (10 if short else 12)
    moved = tp.Body(rectangle((0.45, 0), (0.55, 0.5)), name="gate", gap="seal")
    simulation = advance([moved], spacing, 0.05 if short else 0.2, size=(1.2, 0.9), water=((0, 0), (0.45, depth)))
    skin = SKIN * spacing
    # On the gate, a skin above the floor, and on half of the mouth below it.
    weight = 0.5 * WATER.density * G * ((depth - skin) ** 2 + skin * (depth - 0.5 * skin))
    force = column(simulation, "gate_force_x") / weight
    return {"force": float(np.abs(force - 1).max()), "speed": float(column(simulation, "max_speed").max())}, None


def under_water(low: float, spacing: float, end: float, density: float = HEAVY, **options: Any) -> tp.Simulation:
    """A box 0.4 m wide and 0.2 m high under water 0.6 m deep, from a gap on [m]."""
    block = box((0.4, low), (0.4 + WIDE, low + HIGH), density=density, **options)
    return advance([block], spacing, end, size=(1.2, 0.9), water=((0, 0), (1.2, DEPTH)))


def stand(short: bool) -> tuple[Figures, Curves]:
    """A box on the floor under water carries its weight less its buoyancy, and sealed the water on it, too."""
    spacing, weight = 0.05 if short else 0.04, HEAVY * WIDE * HIGH * G
    seep, seal = (under_water(0.0, spacing, 0.05 if short else 0.2, gap=gap) for gap in ("seep", "seal"))
    skin = SKIN * spacing
    above = (HEAVY * HIGH + WATER.density * (DEPTH - HIGH - skin)) * WIDE * G
    carried = [column(of, "box_contact_force_y") for of in (seep, seal)]
    return {
        "seep": float(np.abs(carried[0] / weight - (1 - WATER.density / HEAVY)).max()),
        "seal": float(np.abs(carried[1] / above - 1).max()),
        "speed": float(column(seep, "max_speed").max()),
    }, None


def squeezed(gap: float, mass: float, end: float, density: float = HEAVY) -> tuple[Array, Array, Array]:
    """Gap g [m] below a box over time [s], and its rate, by the law of a thin film without friction.

    The film's force is rho L^3 / 12 (c g'^2 / g^2 - g'' / g), c = 2 where it leaves, 1/2 where it enters.

    Args:
        gap: at the start [m].
        mass: of the box, and of the rest of the water, that moves with it [kg/m].
        end: of the time [s].
        density: of the box [kg/m^3].
    """
    film, weight = WATER.density * WIDE**3 / 12, (density - WATER.density) * WIDE * HIGH * G

    def rates(_: float, y: Array) -> list[float]:
        c = 2.0 if y[1] < 0 else 0.5
        return [y[1], (c * film * (y[1] / y[0]) ** 2 - weight) / (mass + film / y[0])]

    found = solve_ivp(rates, (0.0, end), [gap, 0.0], rtol=1e-8, max_step=1e-3)
    return found.t, found.y[0], found.y[1]


def mass_of(simulation: tp.Simulation, gap: float) -> float:
    """Mass of a heavy box in water by its first acceleration, without the film below it [kg/m]."""
    first = simulation.history[0]
    acceleration = -first["box_velocity_y"] / first["time"]
    return (HEAVY - WATER.density) * WIDE * HIGH * G / acceleration - WATER.density * WIDE**3 / (12 * gap)


def land(short: bool) -> tuple[Figures, Curves]:
    """A box falls under water, by the law of the film below it; it lands, and carries its weight less its buoyancy."""
    spacing, end = 0.05 if short else 0.03, 1.0
    simulation = under_water(3 * spacing, spacing, end, free=("y",))
    time, gap = column(simulation, "time"), column(simulation, "box_y") - 0.5 * HIGH
    skin = SKIN * spacing
    times, law, _ = squeezed(3 * spacing, mass_of(simulation, 3 * spacing), end)
    lands, rests = time[column(simulation, "box_touches") > 0][0], time > end - 0.2
    carried = column(simulation, "box_contact_force_y") / (HEAVY * WIDE * HIGH * G)
    return {
        "time": float(lands / times[law < 1.001 * skin][0] - 1),
        "carried": float(np.mean(carried[rests]) / (1 - WATER.density / HEAVY) - 1),
        "rebound": float(gap[time > lands].max() / spacing - SKIN),
        "gap": float(np.abs(gap[rests] / skin - 1).max()),
        "energy": unbalanced(simulation),
    }, ("gap [spacings]", {"box": (time, gap / spacing), "theory": (times[law > skin], law[law > skin] / spacing)})


def lift(short: bool) -> tuple[Figures, Curves]:
    """A box half as heavy as water, let go on the floor, rises by the law of the film below it."""
    spacing, end, density = 0.05 if short else 0.04, 0.5, 500.0
    afloat = under_water(3 * spacing, spacing, 1e-3, free=("y",))
    mass = mass_of(afloat, 3 * spacing) + (density - HEAVY) * WIDE * HIGH
    simulation = under_water(0.0, spacing, end, density, free=("y",))
    time, gap = column(simulation, "time"), column(simulation, "box_y") - 0.5 * HIGH
    speed = column(simulation, "box_velocity_y")
    times, law, speeds = squeezed(SKIN * spacing, mass, end, density)
    wide = np.array([0.1, 0.2, 0.4, 0.8]) * spacing
    found, wanted = np.interp(wide, gap, time), np.interp(wide, law, times)
    fast = np.interp(wide, gap, speed) / np.interp(wide, law, speeds)
    opens, here = int(np.argmax(column(simulation, "gap_energy") > 0)), law < 1.5 * spacing
    return {
        "time": float(np.abs(found / wanted - 1).max()),
        "speed": float(np.abs(fast - 1).max()),
        "opened": float(speed[opens + 2] / speed[opens] - 1),
        "energy": unbalanced(simulation),
    }, ("gap [spacings]", {"box": (time, gap / spacing), "theory": (times[here], law[here] / spacing)})


def push(short: bool) -> tuple[Figures, Curves]:
    """A dam break pushes a box along the floor, with Coulomb's friction; it does not rise."""
    figures: Figures = {"friction": 0.0, "lifted": 0.0, "energy": 0.0}
    lines = {}
    for across in (3,) if short else (4, 6, 8):  # spacings in the box's height
        spacing = CUBE / across
        block = box((PUSHED, 0), (PUSHED + CUBE, CUBE), density=SOLID)
        options: Any = {"size": (1.6, 0.6), "water": ((0, 0), (0.4, 0.3))}
        simulation = advance([block], spacing, 0.4 if short else 0.5, **options)
        slides = (column(simulation, "box_velocity_x") > 0.02) & (column(simulation, "impact") == 0)
        along, normal = (column(simulation, f"box_contact_force_{name}")[slides] for name in "xy")
        moved = column(simulation, "box_x") - PUSHED - 0.5 * CUBE
        lifted = np.abs(column(simulation, "box_y") - 0.5 * CUBE - SKIN * spacing) / spacing
        found = {"friction": float(np.abs(along / (FRICTION * normal) + 1).max()), "lifted": float(lifted.max())}
        found["energy"] = unbalanced(simulation)
        figures |= {name: max(figures[name], value) for name, value in found.items()}
        figures[f"moved {across}"] = float(moved[-1])
        lines[f"{across} spacings"] = column(simulation, "time"), moved
    return figures, ("displacement [m]", lines)


def wave_number() -> float:
    """Of the flap's waves [1/m]: w^2 = g k tanh k d."""
    k = square = (2 * math.pi / PERIOD) ** 2 / G
    for _ in range(60):
        k = square / math.tanh(k * POOL)
    return k


def stroke_ratio(foot: float) -> float:
    """Height of waves over the stroke at the surface of a flap that swings at a height above the floor [m].

    Linear theory: R. G. Dean, R. A. Dalrymple, Water Wave Mechanics, 1984, with a stroke that is 0 below ``foot``.
    """
    k = wave_number()
    z = np.linspace(foot, POOL, 2001)
    moved = np.trapezoid((z - foot) / (POOL - foot) * np.cosh(k * z), z)
    return 4 * k * math.sinh(k * POOL) / (math.sinh(2 * k * POOL) + 2 * k * POOL) * float(moved)


def flap(short: bool) -> tuple[Figures, Curves]:
    """A flap whose round foot is in a closed gap on the floor makes waves: their height over that of linear theory."""
    figures: Figures = {"behind": 0.0, "volume": 0.0}
    lines = {}
    for across in (10,) if short else (10, 20):
        spacing, end, omega = POOL / across, 3.4 * PERIOD, 2 * math.pi / PERIOD
        foot = 1.5 * spacing

        def angle(time: float, omega: float = omega) -> float:
            return -SWING * math.sin(omega * time) * (1 - math.exp(-((2 * time / PERIOD) ** 2)))

        shape = tp.shapes.flap((FLAP, 0.0), height=POOL + 0.2, thickness=2 * foot)
        motion = tp.Motion(angle=angle, pivot=(FLAP, foot))
        options: Any = {"size": (5.0, 1.0), "water": ((FLAP, 0), (5.0, POOL)), "columns": {"level": level}}
        simulation = advance([tp.Body(shape, name="flap", motion=motion, gap="seal")], spacing, end, **options)
        time, levels = column(simulation, "time"), column(simulation, "level")
        x = simulation.particles.position[np.unique(simulation.mesh.cells), 0]
        height = float(np.ptp(levels[time > end - PERIOD])) / (stroke_ratio(foot) * 2 * SWING * (POOL - foot)) - 1
        figures[f"height {across}"] = height
        figures["behind"] += float((x < FLAP - 2 * foot).sum())
        figures["volume"] = max(figures["volume"], simulation.state.volume_error)
        lines[f"{across} spacings"] = time, levels
    return figures, ("level [m]", lines)


def level(simulation: tp.Simulation) -> float:
    """Of the surface at the gauge [m]."""
    x, surface = simulation.particles.position, simulation.mesh.surface
    here = np.flatnonzero(surface.front & surface.used & (x[:, 1] > 0.6 * POOL) & (x[:, 0] > FLAP + 0.4))
    here = here[np.argsort(x[here, 0])]
    return float(np.interp(FLAP + GAUGE, x[here, 0], x[here, 1]))


def baffle(short: bool) -> tuple[Figures, Curves]:
    """Sloshing over a thin baffle on the floor, half as high as the water: the period of the first mode."""
    figures: Figures = {}
    lines = {}
    wanted = sloshing_period()
    for across in (12,) if short else (24, 48):
        spacing = SLOSHING / across
        thick = 0.05 * spacing  # half of it
        low, high = 0.5 - thick, 0.5 + thick
        notch = [(low, 0), (low, 0.5 * SLOSHING), (high, 0.5 * SLOSHING), (high, 0)]
        outline: Any = [(0, 0), *notch, (1, 0), (1, 2 * SLOSHING), (0, 2 * SLOSHING)]
        tank = tp.tank(shape=outline, spacing=spacing)
        tank.fill(WATER, where=lambda x: x[:, 1] < SLOSHING + 1e-3 * np.cos(math.pi * x[:, 0]))
        for side in tank.sides:
            tank.wall(side, slip=True)
        case = tp.Case(tank, [WATER], (0.0, -G), free_surface=True)
        simulation = tp.Simulation(case, columns={"middle": middle_of_water})
        while simulation.time < 1.85 * wanted:
            simulation.step()
        time, off = column(simulation, "time"), column(simulation, "middle") - 0.5
        passes = zeros(time, off)[1]
        # Higher modes shift single passes; over three half periods that is less.
        figures[f"period {across}"] = float(2 * (passes[3] - passes[0]) / 3 / wanted - 1)
        lines[f"{across} spacings"] = time, 1e3 * off
    return figures, ("middle of the water [mm]", lines)


def sloshing_period(coarse: int = 160) -> float:
    """Period of the first mode over a baffle without thickness [s], from two grids: the error goes with the spacing."""
    one, two = (_steklov(count) for count in (coarse, 2 * coarse))
    return 2 * two - one


def _steklov(count: int) -> float:
    """The same by finite volumes on ``count`` squares along the tank: Laplace's equation, g phi_y = w^2 phi on top."""
    high, wide = round(SLOSHING * count), count // 2
    number = np.arange(count * high).reshape(high, count)
    shut = np.ones((high, count - 1), dtype=bool)
    shut[: high // 2, wide - 1] = False
    one = np.concatenate([number[:, :-1][shut], number[:-1].ravel()])
    other = np.concatenate([number[:, 1:][shut], number[1:].ravel()])
    size, top = count * high, number[-1]
    beside = coo_matrix((np.ones(len(one)), (one, other)), shape=(size, size)).tocsr()
    beside = beside + beside.T
    # The surface is half a square above the middles of the uppermost ones, whose value is not there.
    whole = np.asarray(beside.sum(axis=1)).ravel()
    whole[top] += 2.0
    inner = diags(whole) - beside
    loads = np.zeros((size, count))
    loads[top, np.arange(count)] = 2.0
    flux = 2.0 * np.eye(count) - 2.0 * splu(inner.tocsc()).solve(loads)[top]
    values = np.sort(np.linalg.eigvalsh(0.5 * (flux + flux.T)))
    return 2 * math.pi / math.sqrt(G * values[1] * count)


def full(short: bool) -> tuple[Figures, Curves]:
    """A sealed box that is lifted off the floor of a full tank, and put down, in one fluid and in two."""
    figures: Figures = {"volume": 0.0, "energy": 0.0}
    lines = {}
    for fluids, depth in (([WATER], 0.8), ([WATER, OIL], 0.44), ([WATER, AIR], 0.44))[short:]:
        lift = tp.Motion(translation=lambda t: (0.0, 0.06 * (1 - math.cos(2 * math.pi * t / 1.2))))
        body = tp.Body(rectangle((0.4, 0), (0.4 + WIDE, HIGH)), name="box", motion=lift, gap="seal")
        simulation = advance([body], 0.04, 1.25, size=(1.2, 0.8), water=((0, 0), (1.2, depth)), fluids=fluids)
        gone = (
            1.2 * 0.8 - WIDE * HIGH - sum(column(simulation, f"volume_{fluid.name}") for fluid in fluids)
        )  # in the closed gap
        gap = column(simulation, "box_y") - 0.5 * HIGH
        shut = gap < 0.5 * 0.04
        shut &= column(simulation, "time") < 0.6
        wrong = np.abs(gone[shut] - WIDE * gap[shut]).max()
        others = [np.abs(column(simulation, f"volume_{of.name}") - 1.2 * (0.8 - depth)).max() for of in fluids[1:]]
        figures["volume"] = max([figures["volume"], simulation.state.volume_error, wrong, *others])
        figures["energy"] = max(figures["energy"], unbalanced(simulation))
        name = " and ".join(fluid.name for fluid in fluids)
        lines[name] = column(simulation, "time"), column(simulation, "external_work").cumsum()
    return figures, ("work on the fluids [J/m]", lines)


# Fluids, depth of water [m], and options of the body.
REFUSED: dict[str, tuple[list[tp.Fluid], float, dict[str, Any]]] = {
    "a sealed body that floats in a full tank": ([WATER], 0.9, {"gap": "seal"}),
    "a tank full of two fluids": ([WATER, AIR], 0.9, {}),
    "a gap that seeps below a body that is fixed": ([WATER], DEPTH, {"density": None}),
    "friction of a body without a gap": ([WATER], DEPTH, {"gap": None}),
}


def refusal(what: str) -> str:
    """The message for a case that does not work; nothing where there is none."""
    fluids, depth, options = REFUSED[what]
    tank = tp.tank((1.2, 0.9), 0.05).fill(WATER, box=((0, 0), (1.2, depth)))
    try:
        tank.add(box((0.4, 0.0), (0.8, HIGH), **options))
        tp.Case(tank, fluids, (0.0, -G), free_surface=True)
    except Invalid as error:
        return str(error)
    return ""
