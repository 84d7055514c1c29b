"""What is refused of openings, and in which words."""

from __future__ import annotations

import numpy as np
import pytest

import tipfem as tp
from tipfem.case.openings import came_back
from tipfem.errors import Several

WATER = tp.Fluid("water", 1000.0, 1e-3)
AIR = tp.Fluid("air", 1.2, 1.8e-5)
VENT = tp.Vent(wall="top", between=((0.1, 0.3), (0.2, 0.3)))


def case(*openings, tank=None, **options):
    tank = (tank or tp.tank((0.4, 0.3), 0.02)).fill(AIR).fill(WATER, box=((0, 0), (0.4, 0.1)))
    return tp.Case(tank, [WATER, AIR], (0, -9.81), openings=openings, **options)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: tp.Inlet(fluid=WATER, velocity=1.0), "wall is left out; give the name of a wall"),
        (lambda: tp.Inlet(wall="left", velocity=1.0), "fluid is ''; it must be a fluid of the case"),
        (lambda: tp.Inlet(wall="left", fluid=WATER), "give discharge, velocity or level, or a profile in m/s"),
        (
            lambda: tp.Inlet(wall="left", fluid=WATER, level=0.2, ramp=0.1),
            "ramp goes with a discharge or a velocity; from a level its pressure says what enters",
        ),
        (
            lambda: tp.Inlet(wall="left", fluid=WATER, velocity=1.0, discharge=0.1),
            "discharge and velocity are given; give one, and profile for its shape",
        ),
        (
            lambda: tp.Inlet(wall="left", fluid=WATER, velocity="fast"),
            "velocity is 'fast', a text; it must be a number in m/s, or a fun",
        ),
        (lambda: tp.Inlet(wall="left", fluid=WATER, velocity=1, profile="flat"), "must be one of 'plug', 'parabola'"),
        (lambda: tp.Inlet(wall="left", fluid=WATER, velocity=1, ramp=-1.0), "ramp is -1.0 s; it must be a number >= 0"),
        (lambda: tp.Inlet(between=((0, 0), (0, 0)), fluid=WATER, velocity=1), "must be two different points"),
        (lambda: tp.Outlet(wall="left", pressure=0, level=0.1, fluid=WATER), "level and pressure are given"),
        (lambda: tp.Outlet(wall="left", level=0.1), "fluid is left out; level is given, and a level needs both"),
        (lambda: tp.Outlet(wall="left", pressure="low"), "it must be a number in Pa, or 'hydrostatic', or a function"),
        (lambda: tp.Outlet(wall="left", direction="up"), "direction is 'up'; it must be one of 'normal', 'free'"),
        (lambda: tp.Vent(wall="top", pressure=3.0), "pressure is 3.0; a vent has the pressure 0, an outlet any other"),
    ],
)
def test_an_opening_refuses(make, message):
    with pytest.raises(ValueError, match=message.replace("(", "[(]")):
        make()


def inlet(**options):
    return tp.Inlet(**{"wall": "left", "fluid": WATER, "discharge": 0.01, "between": ((0, 0), (0, 0.08)), **options})


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: case(inlet()), "inlet_left.*: 0.01 m.2/s flow in, and nothing can leave; add a vent or an outlet"),
        (lambda: case(inlet(discharge=None, velocity=-0.2)), ": 0.2 m/s are drawn off, and nothing can enter; add"),
        (lambda: case(inlet(discharge=lambda t: t)), ": what flows in cannot leave; add a vent or an outlet"),
        (lambda: case(inlet(wall="front"), VENT), "wall is 'front'; the tank has left, right, bottom, top"),
        (lambda: case(inlet(fluid="oil"), VENT), "fluid is 'oil'; the case has water, air"),
        (
            lambda: case(inlet(between=((0, 0), (0, 0.05))), VENT),
            "3 spacings wide|2 spacings wide; its profile needs 4",
        ),
        (lambda: case(inlet(between=((0, 0), (0.1, 0.1))), VENT), "is not on one straight part of the wall 'left'"),
        (lambda: case(inlet(), inlet(between=((0, 0.1), (0, 0.2)), name="two"), VENT), "closer than 3 spacings"),
        (lambda: case(inlet(), inlet(between=((0, 0.2), (0, 0.3))), VENT), "name is 'inlet_left', the name of another"),
        (lambda: case(VENT, free_surface=True), "there is a free surface, beyond which nothing needs to leave"),
        (lambda: case(VENT, interface="interpolated"), "interface is 'interpolated', with which openings do not work"),
        (
            lambda: case(VENT, tank=tp.tank((0.4, 0.3), 0.02, periodic="x")),
            "sides are periodic, with which openings do not",
        ),
        (
            lambda: case(VENT, tank_motion=tp.Motion(angle=lambda t: 0 * t)),
            "tank_motion is given, with which openings do not",
        ),
        (
            lambda: case(VENT, numerics=tp.Numerics(budget="detailed")),
            "budget is 'detailed', with which openings do not",
        ),
        (
            lambda: case(VENT, tank=tp.tank((0.4, 0.3), 0.02).wall("top", velocity=(1.0, 0.0))),
            "wall is 'top', which has a velocity; openings stand still",
        ),
        (lambda: case("inlet"), "openings is .* it must be a list of Inlet, Outlet and Vent"),
    ],
)
def test_a_case_refuses(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_all_openings_without_a_place_are_told_at_once():
    """Each with what is wrong of it: a wall that is not there, too narrow, beside another one."""
    wrong = [inlet(wall="front"), inlet(between=((0, 0), (0, 0.05)), name="narrow"), VENT, inlet(), inlet(name="twin")]
    with pytest.raises(Several) as caught:
        case(*wrong)
    assert [error.path[1] for error in caught.value.errors] == ["inlet_front", "narrow", "twin"]
    for text in ("wall is 'front'; the tank has", "spacings wide; its profile needs 4", "closer than 3 spacings"):
        assert text in str(caught.value)


def test_openings_on_arcs_are_refused():
    tank = tp.tank(shape=tp.shapes.circle((0, 0), 0.2), spacing=0.02).fill(WATER)
    with pytest.raises(ValueError, match=r"is not straight|on an arc"):
        tp.Case(tank, [WATER], (0, 0), openings=[tp.Outlet(wall=tank.sides[0])])


@pytest.mark.parametrize(
    ("openings", "message"),
    [
        ([inlet(discharge=lambda t: "much"), VENT], "discharge at t = 0 s gave 'much'"),
        ([inlet(profile=lambda s, t: s[:2]), VENT], "profile at t = 0 s gave .* it must be 5 finite speeds"),
        ([inlet(profile=lambda s, t: 0 * s), VENT], "profile at t = 0 s lets nothing in, and 0.01 m.2/s are to enter"),
        (
            [tp.Outlet(wall="top", pressure=lambda x, t: np.nan * x[:, 0])],
            "(?s)pressure at .* finite pressures",
        ),
        (
            [inlet(fluid=lambda x, t: 7 + 0 * x[:, 0].astype(int)), VENT],
            "it must be .* names of fluids, or numbers 0 to 1",
        ),
    ],
)
def test_functions_that_return_something_else_are_refused(openings, message):
    with pytest.raises(ValueError, match=message):
        tp.Simulation(case(*openings), time_step=2e-3).step()


def test_outlets_by_which_much_comes_back_are_told():
    """2 of 10 that leave by the drain; not of a reservoir, of a vent, of one by which more enters than leaves."""
    openings = [
        tp.Outlet(wall="right", name="drain"),
        tp.Outlet(wall="left", name="feed"),
        tp.Outlet(wall="left", name="lake", level=0.1, fluid=WATER),
        VENT,
    ]
    passed = {
        "drain": (-6.0, -4.0, 2.0),
        "feed": (-4.0, 3.0, 3.0),
        "lake": (-6.0, -4.0, 2.0),
        "vent_top": (-6.0, -4.0, 2.0),
    }
    rows = [{f"through_{name}_water": values[k] for name, values in passed.items()} for k in range(3)]
    ((name, line),) = came_back(openings, rows).items()
    assert name == "drain"
    assert line.startswith("20 % of what left by drain came back: put it further downstream")
    rows[2]["through_drain_water"] = 0.4
    assert came_back(openings, rows) == came_back(openings, []) == {}
    found = came_back(openings, rows, ["water"])
    assert found == {"vent_top": "water left by vent_top, a vent: put it where the gas stands, or let in less"}
    assert came_back(openings, rows, ["water"], least=20.0) == {}
