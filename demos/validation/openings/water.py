"""Water that runs below, over and against things, under a free surface or with air above it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from tipfem.demos.validation.openings.channels import refused

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


def run(
    tank: tp.Tank, openings: list[tp.Inlet | tp.Outlet], end: float, places: dict[str, float], air: bool
) -> tp.Simulation:
    """A run with the depths of the water at places [m] as columns of its history; vents are left out without air."""
    columns = {name: (lambda run, x=x: depth(run.mesh, run.particles.fluid, 0, x)) for name, x in places.items()}
    if air:
        case = tp.Case(tank, [WATER, AIR], (0, -G), openings=openings)
    else:
        left = [opening for opening in openings if not isinstance(opening, tp.Vent)]
        case = tp.Case(tank, [WATER], (0, -G), openings=left, free_surface=True)
    simulation = tp.Simulation(case, time_step=0.1 * math.sqrt(case.particles.spacing / G), columns=columns)
    while simulation.time < end:
        simulation.step(end)
    return simulation


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
    simulation = run(tank, openings, end, {"brink": edge - 0.01 * h, "before": edge - 3 * first}, air)
    brink, before = means(simulation, 0.5 * end, "brink", "before")
    return {
        "brink": brink / first,
        "before": before / first,
        "hager": froude**2 / (froude**2 + 0.4),
        "refused": refused(simulation),
    }


def weir(across: int, end: float = 3.0, broad: bool = False, air: bool = False) -> dict[str, float]:
    """Coefficient of discharge of a weir 0.1 m high.

    Sharp: q = C (2 / 3) sqrt(2 g) h^1.5, with the depth h above the crest far before it. Broad, with a crest of 0.4 m:
    q = C (2 / 3)^1.5 sqrt(g) H^1.5, with the head H, h and that of the speed.

    Args:
        across: spacings in the depth above the crest.
        end: of the run [s]; figures are means over its second half.
        broad: whether the crest is broad.
        air: whether there is air above the water.
    """
    high, above, long = 0.1, 0.06, 0.4 if broad else 0.0
    h, crest = above / across, 0.5
    back = crest + long + (0.0 if broad else 0.04)
    corners = [(0, 0), (crest, 0), (crest, high), *([(crest + long, high)] if broad else []), (back, -0.02)]
    corners += [(back + 0.34, -0.02), (back + 0.34, 0.24), (0, 0.24)]
    names = ["floor", "plate", *(["crest"] if broad else []), "back", "drain", "end", "roof", "in"]
    tank = filled(corners, names, h, ((0, 0), (crest, high + above)), 0.0, air)
    q = 0.848 * (2 / 3) ** 1.5 * math.sqrt(G) * above**1.5 if broad else 0.66 * 2 / 3 * math.sqrt(2 * G) * above**1.5
    openings = [
        tp.Inlet(between=((0, 0), (0, high)), fluid=WATER, discharge=q, ramp=0.3),
        tp.Outlet(wall="drain"),
        tp.Vent(wall="roof", between=((0.1, 0.24), (0.3, 0.24)), name="left"),
        tp.Vent(wall="roof", between=((back + 0.05, 0.24), (back + 0.25, 0.24)), name="right"),
    ]
    simulation = run(tank, openings, end, {"far": crest - 4 * above}, air)
    far, out = means(simulation, 0.5 * end, "far", "through_outlet_drain_water")
    head, out = far - high, -out
    if broad:
        total = head + (out / far) ** 2 / (2 * G)
        return {
            "coefficient": out / ((2 / 3) ** 1.5 * math.sqrt(G) * total**1.5),
            "head over crest": total / long,
            "refused": refused(simulation),
        }
    return {
        "coefficient": out / (2 / 3 * math.sqrt(2 * G) * head**1.5),
        "rehbock": 0.605 + 1 / (1050 * head - 3) + 0.08 * head / high,
        "refused": refused(simulation),
    }


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
    simulation = run(tank, openings, end, places, air)
    found = means(simulation, 0.8 * end, *places)
    return {
        "depth": float(np.mean(found)) / conjugate,
        "ratio": conjugate / first,
        "refused": refused(simulation),
    }
