"""Walls of tanks that are not convex, above a free surface and where the tank moves."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from render_results import write_results
from tipfem.render import Results, Scene, View, render_frame, strip
from tipfem.render.colours import WALL, rgb
from tipfem.render.layout import make_layout
from tipfem.render.outlines import thin_solids
from tipfem.render.polygons import fill_loops
from tipfem.render.renderer import contents
from tipfem.render.tank import TankOutline

import tipfem as tp
from tipfem.case.outline import tank_outline, tank_pose

# A baffle from the floor between two pools.
BAFFLE = [(0.0, 0.0), (0.4, 0.0), (0.4, 0.3), (0.5, 0.3), (0.5, 0.0), (1.0, 0.0), (1.0, 0.5), (0.0, 0.5)]
SIZE = (640, 480)


def case(**more):
    """Water in the left pool."""
    tank = tp.tank(shape=BAFFLE, spacing=0.05)
    water = tp.Fluid("water", density=1000.0, viscosity=1e-3)
    tank.fill(water, box=((0.0, 0.0), (0.4, 0.2)))
    return tp.Case(tank, fluids=[water], gravity=(0, -9.81), free_surface=True, **more)


def area(triangles):
    """Area of triangles (T, 3, 2)."""
    u, v = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    return 0.5 * abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).sum()


def test_loops_are_filled_but_for_their_holes():
    """The area of a concave outline less that of a round hole; turned, so that no edge is level."""
    angle = np.linspace(0, -2 * np.pi, 48, endpoint=False)
    hole = np.array([0.7, 0.25]) + 0.1 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    expected = 0.5 - 0.03 - 0.5 * 48 * 0.01 * math.sin(2 * math.pi / 48)
    for turn in (0.0, 0.3):
        matrix = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
        assert area(fill_loops([np.array(BAFFLE) @ matrix, hole @ matrix])) == pytest.approx(expected, rel=1e-12)


def drawn(scene):
    """The picture, and a function of positions [m] to its colours."""
    image = render_frame(scene, SIZE, backend="raster").astype(int)
    layout = make_layout(SIZE, *contents(scene, None, View()))

    def at(x, y):
        column, row = layout.pixels([x, y]).astype(int)
        return image[row, column]

    return at


def test_a_baffle_in_the_air_is_drawn():
    """The baffle's sides are walls, the pool without water is empty, and nothing is drawn across the tank's opening."""
    made = case()
    particles = made.particles
    scene = Scene(
        position=particles.position,
        cells=np.empty((0, 3), int),
        fluid=np.zeros(len(particles), int),
        wall=particles.wall,
        fluid_names=("water",),
        spacing=0.05,
        lower=(0, 0),
        upper=(1, 0.5),
        tank=TankOutline(tank_outline(made), 0.05).at_start(),
    )
    at = drawn(scene)
    for x, y in ((0.402, 0.25), (0.498, 0.1), (0.45, 0.292)):
        assert at(x, y).max() < 120
    assert at(0.75, 0.25).min() == 255


def test_results_have_the_outline_where_the_tank_is(tmp_path):
    """The outline in case.json with its sides' names, placed by the columns of the history."""
    made = case(tank_motion=tp.Motion(angle=lambda t: 0.2 * t**2, translation=lambda t: (t**2, 0.0), pivot=(0.5, 0.0)))
    outline = tank_outline(made)
    assert outline["loops"][0]["corners"] == [list(corner) for corner in BAFFLE]
    assert len(outline["loops"][0]["names"]) == len(BAFFLE)
    out = write_results(tmp_path / "run", times=(0.0, 1.0))
    facts = json.loads((out / "case.json").read_text()) | {"tank": outline}
    (out / "case.json").write_text(json.dumps(facts))
    rows = [(0.5, *tank_pose(made, 0.5)), (1.0, *tank_pose(made, 1.0))]
    (out / "history.csv").write_text(
        "time,tank_x,tank_y,tank_angle\n" + "".join(",".join(map(repr, row)) + "\n" for row in rows)
    )
    at_start, later = (Results(out).scene(k).tank for k in (0, 1))
    corner = at_start.loops[0][0]
    np.testing.assert_allclose(at_start.points[corner], (0.0, 0.0), atol=1e-12)
    expected = np.array([1.5, 0.0]) - 0.5 * np.array([math.cos(0.2), math.sin(0.2)])
    np.testing.assert_allclose(later.points[corner], expected, atol=1e-9)


def test_a_tank_that_moves_rests_in_its_own_frame(tmp_path):
    """Places are turned and shifted back, velocities turned with them, and the picture is named after it."""
    made = case(tank_motion=tp.Motion(angle=lambda t: 0.2 * t**2, translation=lambda t: (t**2, 0.0), pivot=(0.5, 0.0)))
    out = write_results(tmp_path / "run", times=(0.0, 1.0))
    with pytest.raises(ValueError, match="does not move"):
        Results(out, frame="tank")
    facts = json.loads((out / "case.json").read_text()) | {"tank": tank_outline(made)}
    (out / "case.json").write_text(json.dumps(facts))
    row = ",".join(map(repr, (1.0, *tank_pose(made, 1.0))))
    (out / "history.csv").write_text(f"time,tank_x,tank_y,tank_angle\n{row}\n")
    room, tank = (Results(out, frame=frame).scene(1) for frame in ("room", "tank"))
    corners = tank.tank.points[tank.tank.loops[0]]
    np.testing.assert_allclose(corners, TankOutline(tank_outline(made), tank.spacing).at_start().points, atol=1e-12)
    turn = np.array([[math.cos(0.2), math.sin(0.2)], [-math.sin(0.2), math.cos(0.2)]])  # of rows, with the tank
    np.testing.assert_allclose((tank.position - (0.5, 0.0)) @ turn + (1.5, 0.0), room.position, atol=1e-6)
    velocity = [np.stack([s.fields["velocity_x"], s.fields["velocity_y"]], axis=1) for s in (room, tank)]
    np.testing.assert_allclose(velocity[1] @ turn, velocity[0], atol=1e-6)
    np.testing.assert_allclose(tank.fields["speed"], room.fields["speed"], rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose((tank.lower, tank.upper), ((0.0, 0.0), (1.0, 0.5)))  # framed as the tank is
    assert strip(out, 1.0, frame="tank", width=640).name == "strip_in_the_tank.png"
    with pytest.raises(ValueError, match="frame 'moon'"):
        Results(out, frame="moon")


BLOCK = ((0, 0), (0.6, 0), (0.6, 0.2), (0.8, 0.2), (0.8, 0), (1, 0), (1, 0.5), (0, 0.5))
GATE = ((0, 0), (1, 0), (1, 0.5), (0.5, 0.5), (0.5, 0.1), (0.48, 0.1), (0.48, 0.5), (0, 0.5))
FIN = ((0, 0), (1, 0), (1, 0.5), (0, 0.5), (0, 0.35), (0.3, 0.3), (0, 0.25))
STEP = ((0, 0.25), (0.5, 0.25), (0.5, 0), (1, 0), (1, 0.5), (0, 0.5))
BOX = ((0, 0), (1, 0), (1, 0.5), (0, 0.5))
HOLE = ((0.3, 0.1), (0.3, 0.4), (0.7, 0.4), (0.7, 0.1))


@pytest.mark.parametrize("size", [(320, 240), (1920, 1080), (3840, 2160)], ids=str)
@pytest.mark.parametrize("turn", [0.0, 0.4])
@pytest.mark.parametrize(
    ("loops", "solid", "hollow"),
    [
        ((BLOCK,), [(0.7, 0.1), (0.61, 0.01), (0.79, 0.01), (0.7, 0.19)], [(0.3, 0.2), (0.7, 0.3)]),
        ((GATE,), [(0.49, 0.3), (0.49, 0.48), (0.49, 0.11)], [(0.3, 0.2), (0.49, 0.05)]),
        ((FIN,), [(0.05, 0.3), (0.2, 0.3)], [(0.5, 0.3), (0.1, 0.4)]),
        ((BOX, HOLE), [(0.5, 0.25), (0.32, 0.12), (0.6, 0.3)], [(0.15, 0.25), (0.5, 0.45)]),
        ((STEP,), [], [(0.75, 0.2), (0.2, 0.4), (0.25, 0.1)]),
    ],
    ids=["block", "gate", "fin", "hole", "step"],
)
def test_solids_are_filled_however_large_the_picture_is(loops, solid, hollow, turn, size):
    """What stands on a wall, hangs from one, or is a hole; beside a step only the wall is drawn."""
    matrix = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
    turned = [np.array(loop) @ matrix for loop in loops]
    facts = {"loops": [{"corners": loop} for loop in turned], "reference": (0, 0)}
    points = np.concatenate(turned)
    scene = Scene(
        position=points,
        cells=[],
        fluid=np.zeros(len(points), int),
        spacing=1e-6,
        lower=points.min(axis=0),
        upper=points.max(axis=0),
        tank=TankOutline(facts, 0.04).at_start(),
    )
    image = render_frame(scene, size, backend="raster").astype(int)
    layout = make_layout(size, *contents(scene, None, View()))

    def colours(places):
        column, row = layout.pixels(np.array(places).reshape(-1, 2) @ matrix).astype(int).T
        return image[row, column]

    assert (abs(colours(solid) - 255 * rgb(WALL)) < 2).all()
    assert (colours(hollow) == 255).all()
    sent = thin_solids(scene)
    assert any(each[0] == 0 for each in sent) == bool(solid)
