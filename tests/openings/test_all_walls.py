"""Openings in walls of all kinds: either the books of volume close in each step, or a sentence refuses them."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

import tipfem as tp

WATER = tp.Fluid("water", 1000.0, 1e-2)
AIR = tp.Fluid("air", 1.2, 1.8e-5)
H = 0.02
BOX = np.array([(0, 0), (0.32, 0), (0.32, 0.2), (0, 0.2)])


def strength(kind):
    """What an inlet is given: lets in, draws off, turns, or both at once over its width."""
    return {
        "in": {"velocity": 0.2, "ramp": 0.02},
        "out": {"velocity": -0.2, "ramp": 0.02},
        "turns": {"velocity": lambda t: 0.2 * math.sin(300 * t)},
        "profile": {"profile": lambda s, t: 0.1 * min(t / 0.02, 1.0) * np.where(s < 0.06, 1.0, -1.0)},
    }[kind]


def polygon(corners, **more):
    names = ["bottom", "right", "top", "left"]
    return tp.tank(shape=tp.shapes.polygon(np.asarray(corners).tolist(), names=names, **more), spacing=H)


def turned(angle, skew=0.0):
    """The box, sheared and turned about its corner."""
    c, s = math.cos(angle), math.sin(angle)
    return (BOX + np.outer(BOX[:, 1], (skew, 0.0))) @ np.array([(c, s), (-s, c)])


def filled(tank, corners, slip):
    """Air above water where the tank has both; a tank whose walls slip, or not."""
    low, high = np.min(corners, axis=0), np.max(corners, axis=0)
    tank.fill(AIR).fill(WATER, box=((low[0] - 1, low[1] - 1), (high[0] + 1, 0.5 * (low[1] + high[1]))))
    if slip:
        for name in ("bottom", "right", "top", "left"):
            tank.wall(name, slip=True)
    return tank


def part(a, b, first=0.25, last=0.75):
    """The middle of a side between two corners."""
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    return tuple(tuple((a + r * (b - a)).tolist()) for r in (first, last))


def require_books_closed(case, steps=10):
    simulation = tp.Simulation(case, time_step=3e-3)
    start = simulation.state.volume.copy()
    for _ in range(steps):
        simulation.step()
        passed = simulation.state.parts["openings"].total
        assert np.abs(simulation.state.volume - start - passed.sum(axis=0)).max() < 1e-10 * start.sum()
    assert 0.02 < simulation.particles.max_speed < 5.0


def two_openings(corners, side, kind, fluid=WATER):
    """An inlet in a side, and an outlet in that opposite to it."""
    corners = np.asarray(corners)
    ends = [part(corners[k % 4], corners[(k + 1) % 4]) for k in (side, side + 2)]
    return [tp.Inlet(between=ends[0], fluid=fluid, name="in", **strength(kind)), tp.Outlet(between=ends[1], name="out")]


@pytest.mark.parametrize("kind", ["in", "out", "turns", "profile"])
@pytest.mark.parametrize(
    ("angle", "skew", "side", "slip"),
    [(0.0, 0.0, 3, False), (0.0, 0.0, 0, True), (0.4, 0.0, 3, True), (-0.7, 0.0, 2, False), (0.0, 0.5, 1, True)],
)
def test_books_close_in_straight_and_sloping_walls(kind, angle, skew, side, slip):
    corners = turned(angle, skew)
    tank = filled(polygon(corners), corners, slip)
    require_books_closed(tp.Case(tank, [WATER, AIR], (0, -9.81), openings=two_openings(corners, side, kind)))


@pytest.mark.parametrize("kind", ["in", "out"])
def test_books_close_beside_a_round_hole(kind):
    """Of a wall that slips, in a tank full of one fluid."""
    tank = tp.tank(
        shape=tp.shapes.polygon(
            BOX.tolist(),
            names=["bottom", "right", "top", "left"],
            holes=[tp.shapes.circle((0.16, 0.1), 0.04, name="hole")],
        ),
        spacing=H,
    )
    tank.fill(WATER).wall("hole", slip=True)
    require_books_closed(tp.Case(tank, [WATER], (0, 0), openings=two_openings(BOX, 3, kind)))


def test_books_close_beside_a_wall_that_slides():
    tank = tp.tank((0.32, 0.2), H).fill(WATER).wall("bottom", velocity=(0.5, 0.0))
    require_books_closed(tp.Case(tank, [WATER], (0, 0), openings=two_openings(BOX, 3, "in")))


def test_books_close_beside_a_side_that_moves():
    """What the side pushes out has left."""
    tank = tp.tank((0.32, 0.2), H).fill(WATER)
    for side in ("right", "top", "bottom"):
        tank.wall(side, slip=True)
    tank.wall("left", slip=True, motion=lambda t: 0.1 * t * t)
    case = tp.Case(tank, [WATER], (0, 0), openings=[tp.Outlet(between=part(BOX[2], BOX[3]), name="out")])
    simulation = tp.Simulation(case, time_step=3e-3)
    start = simulation.state.volume[0]
    for _ in range(10):
        simulation.step()
        passed = simulation.state.parts["openings"].total.sum()
        assert abs(simulation.state.volume[0] - start - passed) < 1e-10 * start
    assert simulation.state.volume[0] == pytest.approx(start - 0.2 * 0.1 * simulation.time**2, rel=1e-6)


def mesh_of_box(path):
    """A mesh file in the format 2.2 of Gmsh: a box of triangles, and its sides by name."""
    across, up = 16, 10
    x, y = np.meshgrid(np.linspace(0, 0.32, across + 1), np.linspace(0, 0.2, up + 1))
    number = np.arange(x.size).reshape(x.shape) + 1
    a, b, c, d = (n.ravel() for n in (number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]))
    sides = {1: number[0], 2: number[:, -1], 3: number[-1], 4: number[:, 0]}
    elements = [f"1 2 {tag} {tag} {p} {q}" for tag, line in sides.items() for p, q in itertools.pairwise(line)]
    cells = [*zip(a, b, c, strict=True), *zip(a, c, d, strict=True)]
    elements += [f"2 2 5 5 {p} {q} {r}" for p, q, r in cells]
    names = ['1 1 "bottom"', '1 2 "right"', '1 3 "top"', '1 4 "left"', '2 5 "water"']
    nodes = [f"{k + 1} {p:.17g} {q:.17g} 0" for k, (p, q) in enumerate(zip(x.ravel(), y.ravel(), strict=True))]
    lines = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$PhysicalNames", "5", *names, "$EndPhysicalNames"]
    lines += ["$Nodes", str(len(nodes)), *nodes, "$EndNodes", "$Elements", str(len(elements))]
    path.write_text("\n".join([*lines, *(f"{k + 1} {e}" for k, e in enumerate(elements)), "$EndElements"]) + "\n")
    return path


@pytest.mark.parametrize("kind", ["in", "out"])
def test_books_close_in_walls_of_a_mesh_file(tmp_path, kind):
    tank = tp.read_mesh(mesh_of_box(tmp_path / "box.msh"))
    require_books_closed(tp.Case(tank, [WATER], (0, 0), openings=two_openings(BOX, 3, kind)))


def moved(**wall):
    return lambda: (tp.tank((0.32, 0.2), H).fill(WATER).wall("left", **wall), {})


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: (tp.tank(shape=tp.shapes.circle((0.16, 0.1), 0.16), spacing=H).fill(WATER), {}), "straight"),
        (moved(velocity=(0.0, 0.5)), "has a velocity; openings stand still"),
        (moved(slip=True, motion=lambda t: 0.1 * t * t), "has a motion; openings stand still"),
        (
            lambda: (tp.tank((0.32, 0.2), H, periodic="x").fill(WATER), {}),
            "sides are periodic, with which openings do not work",
        ),
        (lambda: (tp.tank((0.32, 0.2), H, periodic="xy").fill(WATER), {}), "sides are periodic, with which openings"),
        (
            lambda: (tp.tank((0.32, 0.2), H).fill(WATER), {"tank_motion": tp.Motion(angle=lambda t: 0.0 * t)}),
            "tank_motion is given, with which openings do not work",
        ),
    ],
)
def test_other_walls_refuse_openings_in_a_sentence(make, message):
    tank, more = make()
    there = [
        tp.Inlet(between=((0, 0.04), (0, 0.16)), fluid=WATER, velocity=0.1),
        tp.Outlet(between=((0.32, 0.04), (0.32, 0.16))),
    ]
    with pytest.raises(ValueError, match=message) as caught:
        tp.Case(tank, [WATER], (0, 0), openings=there, **more)
    assert all(line.startswith(("inlet 'inlet'", "outlet 'outlet'")) for line in str(caught.value).splitlines())
