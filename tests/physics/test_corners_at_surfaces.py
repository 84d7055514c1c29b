"""Corners that meet a free surface: of bodies, of walls, and of the liquid itself, head on and aside."""

from __future__ import annotations

import math

import numpy as np
import pytest

import tipfem as tp

WATER = tp.Fluid("water", density=1000.0, viscosity=1e-3)
H = 0.04
DEPTH = 0.32
SIZE = 0.96
MIDDLE = SIZE / 2
STAYS = tp.Motion(translation=lambda t: np.zeros(2))
START = tp.Motion(translation=lambda t: np.array([-8.0 * t**2, 0.0]))


def turned(corners, degrees=0.0):
    """Corners (K, 2) turned by an angle, about the place that is then the lowest, which is the origin."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    x = np.asarray(corners, dtype=float) @ np.array([[c, s], [-s, c]])
    return x - x[np.argmin(x[:, 1])]


def wedge(deadrise):
    half = 0.15
    rise = half * math.tan(math.radians(deadrise))
    return [(0, 0), (half, rise), (half, rise + 0.1), (-half, rise + 0.1), (-half, rise)]


BOX = [(-0.12, 0), (0.12, 0), (0.12, 0.2), (-0.12, 0.2)]
HOOK = [(0, 0), (0.12, 0), (0.12, 0.16), (0.24, 0.16), (0.24, 0.28), (0, 0.28)]


def flow(tank, **options):
    return tp.Case(tank, [WATER], (0, -9.81), free_surface=True, **options)


def entry(corners, aside=0.0, degrees=0.0, speed=1.0, **options):
    """A body comes down on still water, its lowest corner so many spacings beside a particle of the surface."""
    corner = (MIDDLE + aside * H, DEPTH + 0.8 * H)
    shape = turned(corners, degrees) + corner
    how = options or {"motion": tp.Motion(translation=lambda t: np.array([0.0, -speed * t]))}
    tank = tp.tank((SIZE, SIZE), H).fill(WATER, box=((0, 0), (SIZE, DEPTH)))
    return flow(tank.add(tp.Body(shape, name="b", **how))), corner


def on_an_apex(aside, *, drop):
    """Water falls on a corner of the floor."""
    x, top = MIDDLE + aside * H, 0.16
    tank = tp.tank(
        shape=[(0, 0), (x - 0.12, 0), (x, top), (x + 0.12, 0), (SIZE, 0), (SIZE, SIZE), (0, SIZE)], spacing=H
    )
    if drop:
        tank.fill(WATER, shape=tp.shapes.circle((MIDDLE, top + 0.8 * H + 0.12), 0.12))
    else:
        tank.fill(WATER, box=((MIDDLE - 0.16, top + 0.8 * H), (MIDDLE + 0.16, top + 0.32)))
    return flow(tank), (x, top)


def below_a_wedge(aside):
    """A piston lifts water to the corner of a body that stays."""
    corner = (MIDDLE + aside * H, DEPTH + 0.8 * H)
    tank = tp.tank((SIZE, SIZE), H).fill(WATER, box=((0, 0), (SIZE, DEPTH)))
    tank.wall("left", motion=lambda t: 10.0 * t**2)
    return flow(tank.add(tp.Body(turned(wedge(45)) + corner, name="b", motion=STAYS))), corner


def beside_a_wedge(aside):
    """A column of water collapses on to a corner of a body beside it."""
    corner = np.array([0.32 + 0.8 * H, 0.24 + aside * H])
    tank = tp.tank((SIZE, SIZE), H).fill(WATER, box=((0, 0), (0.32, 0.6)))
    return flow(tank.add(tp.Body(corner + [(0, 0), (0.25, -0.08), (0.25, 0.08)], name="b", motion=STAYS))), corner


def thrown_to_a_corner():
    """A tank with a corner in its roof starts, and throws the water there."""
    x, low = 0.7, DEPTH + 0.8 * H
    corners = [(0, 0), (SIZE, 0), (SIZE, 0.6), (x + 0.2, 0.6), (x, low), (x - 0.2, 0.6), (0, 0.6)]
    return flow(tp.tank(shape=corners, spacing=H).fill(WATER, box=((0, 0), (SIZE, DEPTH))), tank_motion=START), (x, low)


def tips(aside):
    """A wedge of water falls on a wedge of water."""
    x = MIDDLE + aside * H
    tank = tp.tank((SIZE, SIZE), H).fill(WATER, shape=[(0.08, 0), (0.88, 0), (MIDDLE, DEPTH)])
    low = DEPTH + 0.8 * H
    return flow(tank.fill(WATER, shape=[(x, low), (x + 0.25, low + 0.25), (x - 0.25, low + 0.25)])), None


CASES = {
    "wedge of 30 degrees": lambda: entry(wedge(30)),
    "wedge in short steps": lambda: entry(wedge(30)),
    "wedge, slowly": lambda: entry(wedge(30), speed=0.25),
    "wedge, aside": lambda: entry(wedge(30), 0.3),
    "wedge, between particles": lambda: entry(wedge(30), 0.5),
    "wedge, tilted": lambda: entry(wedge(30), 0.0, 12.0),
    "wedge that falls": lambda: entry(wedge(30), density=500.0, velocity=(0.0, -1.0)),
    "wedge along which water slides": lambda: entry(wedge(30), slip=True, density=500.0, velocity=(0.0, -1.0)),
    "wedge of 60 degrees": lambda: entry(wedge(60)),
    "box on its corner": lambda: entry(BOX, 0.0, 45.0),
    "box, tilted": lambda: entry(BOX, 0.2, 20.0),
    "hook": lambda: entry(HOOK, 0.0, 30.0),
    "column on an apex": lambda: on_an_apex(0.0, drop=False),
    "column beside an apex": lambda: on_an_apex(0.3, drop=False),
    "drop on an apex": lambda: on_an_apex(0.0, drop=True),
    "piston below a wedge": lambda: below_a_wedge(0.0),
    "piston below a wedge, aside": lambda: below_a_wedge(0.4),
    "tank that starts": thrown_to_a_corner,
    "side of a column": lambda: beside_a_wedge(0.0),
    "side of a column, between particles": lambda: beside_a_wedge(0.5),
    "tip on tip": lambda: tips(0.0),
    "tip beside tip": lambda: tips(0.3),
}


@pytest.mark.slow(
    only=(
        "wedge of 30 degrees",
        "wedge in short steps",
        "wedge, between particles",
        "wedge, tilted",
        "drop on an apex",
        "piston below a wedge",
        "piston below a wedge, aside",
        "tip on tip",
        "tip beside tip",
    )
)
@pytest.mark.parametrize("name", CASES)
def test_a_corner_that_meets_a_surface_gets_wet_and_the_flow_goes_on(name):
    case, corner = CASES[name]()
    simulation = tp.Simulation(case, time_step=1e-3 if "short" in name else None)
    before, after = simulation.volume("water"), 0
    tip = -1 if corner is None else int(np.linalg.norm(case.particles.position - corner, axis=1).argmin())
    while simulation.time < 0.15 and after < (60 if "short" in name else 12):
        simulation.step()
        after += bool(after or (tip >= 0 and simulation.mesh.surface.used[tip]))
    assert after or tip < 0
    assert simulation.volume("water") == pytest.approx(before, rel=1e-12)
    rows = simulation.history
    assert sum(row["refused_steps"] for row in rows) <= 6
    scale = max(row["kinetic_energy"] for row in rows)
    assert max(abs(row["energy_residual"]) for row in rows) < 1e-7 * scale
