"""Contact angles on bodies: Young's force and its reaction, discs that float by tension, and what is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest

import tipfem as tp
from tipfem.casefile.describing import describe
from tipfem.casefile.loading import read_case
from tipfem.casefile.problems import CaseFileError
from tipfem.errors import Invalid
from tipfem.physics.bodies.motion import BodyStates
from tipfem.physics.surface_tension.edges import TensionEdges

# In units of sigma / (rho g) of the difference of the densities.
LIQUID, GAS = tp.Fluid("liquid", 1.0, 0.2), tp.Fluid("gas", 0.01, 0.002)
GRAVITY, LEVEL = 1 / 0.99, 2.4
EXACT = tp.Numerics(newton_tolerance=1e-11)


def bath(shape, spacing=0.25, angle=None, **body):
    """A bath with a body in the middle, 6 wide and 4.8 high."""
    tank = tp.tank((6.0, 4.8), spacing).fill(GAS).fill(LIQUID, box=((0, 0), (6, LEVEL)))
    for side in ("left", "right"):
        tank.wall(side, slip=True)
    given = {} if angle is None else {"contact_angle": {("liquid", "gas"): angle}}
    tank.add(tp.Body(shape, name="body", **given, **body))
    tension = {("liquid", "gas"): 1.0}
    return tp.Simulation(tp.Case(tank, [LIQUID, GAS], (0, -GRAVITY), surface_tension=tension, numerics=EXACT))


def contacts(simulation):
    """Numbers of the contacts on the body."""
    edges = simulation.state.part(TensionEdges)
    ends = np.unique(np.concatenate([edges.one, edges.other]))
    return ends[simulation.state.part(BodyStates).label[ends] >= 0]


DISC = tp.shapes.circle((3.0, LEVEL), 1.0)
BOX = tp.shapes.rectangle((2.5, 1.2), (3.5, 3.6))


@pytest.mark.parametrize("law", [{}, {"slip": True}, {"law": "layer"}])
def test_a_level_that_meets_a_box_at_a_right_angle_stays(law):
    simulation = bath(BOX, angle=90, **law)
    for _ in range(5):
        simulation.step()
    assert simulation.particles.max_speed < 1e-9
    lifts = 1.2 + 0.01 * GRAVITY * 2.4  # of a box as wide as high above its lower side, and of the gas
    assert simulation.history[-1]["body_force_y"] == pytest.approx(lifts, rel=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("law", [{}, {"slip": True}])
def test_a_disc_is_drawn_to_where_its_contacts_climb(law):
    """At 60 degrees the liquid climbs, and draws the disc down; no energy is left over, nor momentum."""
    simulation = bath(DISC, angle=60, density=0.5, **law)
    start = simulation.particles.position[contacts(simulation), 1].copy()
    for _ in range(25):
        simulation.step()
    rows, now = simulation.history, simulation.particles.position[contacts(simulation), 1]
    assert len(start) == len(now) == 2
    slid = now - start - (rows[-1]["body_y"] - LEVEL)
    assert (slid > 0.05).all()  # relative to the disc
    assert rows[-1]["body_velocity_y"] < -0.01
    assert abs(rows[-1]["body_velocity_x"]) < 0.02
    # The outline's wetting energy falls by cos(60 degrees) times the way of each contact along it.
    work = sum(row["external_work"] for row in rows)
    assert work == pytest.approx(0.5 * slid.sum(), rel=0.15)
    scale = max(row["kinetic_energy"] for row in rows)
    assert max(abs(row["energy_residual"]) for row in rows) < 2e-7 * scale
    for axis in "xy":
        assert max(abs(row[f"momentum_residual_{axis}"]) for row in rows) < 1e-7
    on = simulation.state.part(BodyStates).label >= 0
    away = simulation.particles.position[on] - [rows[-1]["body_x"], rows[-1]["body_y"]]
    np.testing.assert_allclose(np.hypot(*away.T), 1.0, atol=0.03)  # a polygon's corners, and contacts on its chords


def test_a_disc_in_a_liquid_alone_is_drawn_down_by_its_surface():
    tank = tp.tank((6.0, 4.8), 0.25).fill(LIQUID, box=((0, 0), (6, LEVEL)))
    tank.add(tp.Body(DISC, name="body", density=0.5, contact_angle={"liquid": 60}))
    tension = {"liquid": 1.0}
    case = tp.Case(tank, [LIQUID], (0, -1), free_surface=True, surface_tension=tension, numerics=EXACT)
    simulation = tp.Simulation(case)
    for _ in range(15):
        simulation.step()
    rows = simulation.history
    assert rows[-1]["body_velocity_y"] < -0.01
    assert simulation.particles.position[contacts(simulation), 1].min() - rows[-1]["body_y"] > 0.03
    scale = max(row["kinetic_energy"] for row in rows)
    assert max(abs(row["energy_residual"]) for row in rows) < 1e-6 * scale


def test_without_an_angle_contacts_stay_where_the_outline_holds_them():
    simulation = bath(DISC, density=0.5)
    start = contacts(simulation)
    place = simulation.particles.position[start, 1] - LEVEL
    for _ in range(10):
        simulation.step()
    now = contacts(simulation)
    moved = simulation.particles.position[now, 1] - simulation.history[-1]["body_y"] - place
    assert np.abs(moved).max() < 0.05


@pytest.mark.slow
def test_a_disc_heavier_than_the_liquid_floats():
    """phi of the contacts by the balance of weight, pressure and tension at 120 degrees."""
    from tipfem.demos.validation.drops import at_rest

    found = at_rest.floating(120.0, 1.1, "no-slip", across=8, end=14.0)
    assert abs(found["height"]) < 0.06
    assert abs(found["contact"]) < 0.06


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({("liquid", "oil"): 60}, "body 'body': contact_angle: without surface tension a contact angle has no meaning"),
        ({("liquid", "gas"): 190}, "body 'body': it is 190; it must be from 0 to 180 degrees"),
        ({("liquid", "gas"): (60, 90)}, "one number of degrees on a body; only a wall at rest holds contacts"),
        (60, "body 'body': contact_angle is 60; it must be a dict from two fluids to an angle"),
    ],
)
def test_mistakes_are_told(given, text):
    tank = tp.tank((6.0, 4.8), 0.4).fill(GAS).fill(LIQUID, box=((0, 0), (6, LEVEL)))
    tank.add(tp.Body(DISC, name="body", contact_angle=given))
    with pytest.raises(Invalid, match=text):
        tp.Case(tank, [LIQUID, GAS], (0, -1), surface_tension={("liquid", "gas"): 1.0})


TEXT = """
gravity = [0, -1]
[fluids.liquid]
density = 1.0
viscosity = 0.2
[fluids.gas]
density = 0.01
viscosity = 0.002
[surface_tension]
liquid.gas = 1.0
[tank]
size = [6.0, 4.8]
spacing = 0.4
[[fill]]
fluid = "gas"
[[fill]]
fluid = "liquid"
box = [[0, 0], [6.0, 2.4]]
[[bodies]]
name = "disc"
density = 0.5
disc = { centre = [3.0, 2.4], radius = 1.0 }
contact_angle.liquid.gas = 120
[time]
end = 0.1
"""


def test_case_files_have_angles_of_bodies():
    case = read_case(TEXT, "case.toml").case()
    assert case.bodies[0].contact_angle == {("liquid", "gas"): 120}
    ((mean, half),) = case.body_cosines[0].values()
    assert (mean, half) == pytest.approx((math.cos(math.radians(120)), 0.0))
    again = read_case(describe(case, 0.1).text, "again.toml").case()
    assert again.body_cosines == case.body_cosines
    with pytest.raises(CaseFileError, match="one number of degrees on a body"):
        read_case(TEXT.replace("= 120", "= [60, 120]"), "case.toml")
