"""Water that runs below, over and against things, under a free surface or with air above it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from tipfem.demos.validation.openings.channels import advance, refused

import tipfem as tp
from tipfem.mesh.measures import depth

WATER = tp.Fluid("water", density=998.2, viscosity=1.002e-3)
AIR = tp.Fluid("air", density=1.204, viscosity=1.825e-5)
G = 9.81  # m/s^2


def filled(
    corners: list[tuple[float, float]], names: list[str], spacing: float, box: Any, speed: float, air: bool
) -> tp.Tank:
    """A tank of an outline with a box of water that runs to the right at a speed [m/s], and slip walls."""
    tank = tp.tank(shape=tp.shapes.polygon(corners, names=names), spacing=spacing)
    if air:
        tank.fill(AIR)
    tank.fill(WATER, box=box, velocity=(speed, 0.0))
    for name in dict.fromkeys(names):
        tank.wall(name, slip=True)
    return tank


def simulation_of(
    tank: tp.Tank, openings: list[tp.Inlet | tp.Outlet], places: dict[str, float], air: bool
) -> tp.Simulation:
    """One with the depths of the water at places [m] as columns of its history; vents are left out without air."""
    columns = {name: (lambda run, x=x: depth(run.mesh, run.particles.fluid, 0, x)) for name, x in places.items()}
    if air:
        case = tp.Case(tank, [WATER, AIR], (0, -G), openings=openings)
    else:
        left = [opening for opening in openings if not isinstance(opening, tp.Vent)]
        case = tp.Case(tank, [WATER], (0, -G), openings=left, free_surface=True)
    return tp.Simulation(case, time_step=0.1 * math.sqrt(case.particles.spacing / G), columns=columns)


def means(simulation: tp.Simulation, since: float, *names: str) -> list[float]:
    """Means over time of columns from a time on [s]; those of what passes are per time."""
    rows = [row for row in simulation.history if row["time"] > since]
    time = sum(row["time_step"] for row in rows)
    return [
        sum(row[name] * (1.0 if name.startswith("through") else row["time_step"]) for row in rows) / time
        for name in names
    ]


def below(floor: float, surface: float, speed: float) -> tp.Inlet:
    """An inlet on the wall "in" for water from a floor to its surface [m], at a speed [m/s]."""
    return tp.Inlet(between=((0.0, floor), (0.0, surface)), fluid=WATER, velocity=speed)


def overfall(across: int, froude: float = 2.0, end: float = 1.6, air: bool = False) -> dict[str, float]:
    """Depth at the brink of a free overfall, over that of the supercritical flow before it.

    By W. H. Hager (J. Hydraul. Eng. 109, 1983) it is F^2 / (F^2 + 0.4) with the Froude number F of that flow.

    Args:
        across: spacings in the depth.
        froude: number.
        end: of the run [s]; figures are means over its second half.
        air: whether there is air above the water.
    """
    first, floor, edge = 0.06, 0.12, 0.4
    h, speed = first / across, froude * math.sqrt(G * first)
    corners = [(0, floor), (edge, floor), (edge, 0.0), (1.0, 0.0), (1.0, 0.24), (0.0, 0.24)]
    names = ["floor", "face", "drain", "end", "roof", "in"]
    tank = filled(corners, names, h, ((0, floor), (edge, floor + first)), speed, air)
    openings = [
        below(floor, floor + first, speed),
        tp.Outlet(wall="drain"),
        tp.Vent(wall="roof", between=((0.1, 0.24), (0.3, 0.24)), name="left"),
        tp.Vent(wall="roof", between=((0.45, 0.24), (0.65, 0.24)), name="right"),
    ]
    places = {"brink": edge - 0.01 * h, "before": edge - 3 * first}
    simulation = advance(simulation_of(tank, openings, places, air), end)
    brink, before = means(simulation, 0.5 * end, "brink", "before")
    return {
        "brink": brink / first,
        "before": before / first,
        "hager": froude**2 / (froude**2 + 0.4),
        "refused": refused(simulation),
    }


HIGH, ABOVE, BROAD = (
    0.1,
    0.06,
    0.4,
)  # height of the weirs, depth above the crest for which they are made, broad crest [m]
CREST, BEFORE = 0.5, 4 * ABOVE  # from the inlet to the crest, and before it, where the depth is taken [m]
FLOOR, ROOF, POOL = -0.02, 0.24, 0.34  # heights of drain and roof, length behind the weir [m]
VENTS = (0.1, 0.3), (0.05, 0.25)  # in the roof, from the inlet, and from the foot of the weir's back [m]
RAMP = 0.3  # of the discharge [s]


def weir_outline(broad: bool) -> tuple[list[tuple[float, float]], list[str]]:
    """Corners of the channel with a weir, sharp or broad, from the floor at the inlet on [m]; names of its sides."""
    long = BROAD if broad else 0.0
    back = CREST + long + (0.0 if broad else 0.04)
    corners = [(0.0, 0.0), (CREST, 0.0), (CREST, HIGH), *([(CREST + long, HIGH)] if broad else []), (back, FLOOR)]
    corners += [(back + POOL, FLOOR), (back + POOL, ROOF), (0.0, ROOF)]
    return corners, ["floor", "plate", *(["crest"] if broad else []), "back", "drain", "end", "roof", "in"]


def weir_discharge(broad: bool) -> float:
    """What enters before a weir [m^2/s], about what flows over it with the depth `ABOVE`."""
    coefficient = 0.848 * (2 / 3) ** 1.5 if broad else 0.66 * 2 / 3 * math.sqrt(2)
    return float(coefficient * math.sqrt(G) * ABOVE**1.5)


def weir_figures(far: float, out: float, broad: bool) -> dict[str, float]:
    """Coefficient of discharge by the depth before a weir [m] and the discharge [m^2/s], and what it should be.

    Sharp: q = C (2 / 3) sqrt(2 g) h^1.5, with the depth h above the crest. Broad: q = C (2 / 3)^1.5 sqrt(g) H^1.5, with
    the head H, h and that of the speed.
    """
    head = far - HIGH
    if broad:
        total = head + (out / far) ** 2 / (2 * G)
        found = {"coefficient": out / ((2 / 3) ** 1.5 * math.sqrt(G) * total**1.5), "expected": 0.848}
        return {**found, "head over crest": total / BROAD}
    rehbock = 0.605 + 1 / (1050 * head - 3) + 0.08 * head / HIGH
    return {"coefficient": out / (2 / 3 * math.sqrt(2 * G) * head**1.5), "expected": rehbock}


def weir_simulation(across: int, broad: bool = False, air: bool = False) -> tp.Simulation:
    """A weir 0.1 m high, see `weir`."""
    corners, names = weir_outline(broad)
    tank = filled(corners, names, ABOVE / across, ((0, 0), (CREST, HIGH + ABOVE)), 0.0, air)
    foot = corners[-4][0]
    vents = [((left + x0, ROOF), (left + x1, ROOF)) for left, (x0, x1) in zip((0.0, foot), VENTS, strict=True)]
    openings = [
        tp.Inlet(between=((0, 0), (0, HIGH)), fluid=WATER, discharge=weir_discharge(broad), ramp=RAMP),
        tp.Outlet(wall="drain"),
        *(tp.Vent(wall="roof", between=ends, name=name) for ends, name in zip(vents, ("left", "right"), strict=True)),
    ]
    return simulation_of(tank, openings, {"far": CREST - BEFORE}, air)


def weir(across: int, end: float = 3.0, broad: bool = False, air: bool = False) -> dict[str, float]:
    """Coefficient of discharge of a weir 0.1 m high with a crest of 0.4 m or a sharp one, see `weir_figures`.

    Args:
        across: spacings in the depth above the crest.
        end: of the run [s]; figures are means over its second half.
        broad: whether the crest is broad.
        air: whether there is air above the water.
    """
    simulation = advance(weir_simulation(across, broad, air), end)
    far, out = means(simulation, 0.5 * end, "far", "through_outlet_drain_water")
    return {**weir_figures(far, -out, broad), "refused": refused(simulation)}


def bore(across: int, froude: float = 2.0, air: bool = False) -> dict[str, float]:
    """Depth behind a bore that runs back from a closed end, over the conjugate one.

    Water of the depth y1 runs at the speed u1 = froude sqrt(g y1) against a wall. In the frame of the bore, that moves
    at the speed c, this is a hydraulic jump: y1 (u1 + c) = y2 c and (u1 + c)^2 = g y2 (y1 + y2) / (2 y1).
    """
    first, length, roof = 0.06, 1.6, 0.3
    speed, h = froude * math.sqrt(G * first), first / across
    ratio = np.linspace(1.01, 6, 100_000)
    change = (speed * ratio / (ratio - 1)) ** 2 - G * ratio * first * (1 + ratio) / 2
    conjugate = first * float(ratio[np.argmax(change < 0)])
    corners = [(0.0, 0.0), (length, 0.0), (length, roof), (0.0, roof)]
    tank = filled(corners, ["floor", "end", "roof", "in"], h, ((0, 0), (length, first)), speed, air)
    openings = [
        below(0.0, first, speed),
        tp.Vent(wall="roof", between=((0.2, roof), (0.8, roof))),
    ]
    bore_speed = speed * first / (conjugate - first)
    end = 0.6 * length / bore_speed
    places = {f"depth_{k}": length - (0.1 + 0.05 * k) * length for k in range(5)}
    simulation = advance(simulation_of(tank, openings, places, air), end)
    found = means(simulation, 0.8 * end, *places)
    return {
        "depth": float(np.mean(found)) / conjugate,
        "ratio": conjugate / first,
        "refused": refused(simulation),
    }
