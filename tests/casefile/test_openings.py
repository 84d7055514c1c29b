"""Openings in case files."""

from __future__ import annotations

import numpy as np
import pytest
from case_texts import WATER_IN_AIR

import tipfem as tp
from tipfem.app.commands import main
from tipfem.casefile.describing import describe
from tipfem.casefile.loading import read_case
from tipfem.casefile.openings import Openings
from tipfem.casefile.problems import CaseFileError

GOOD = (
    WATER_IN_AIR
    + """\
box = [[0, 0], [0.4, 0.1]]
[[inlets]]
wall = "left"
fluid = "water"
between = [[0, 0], [0, 0.1]]
discharge = { form = "sine", amplitude = 0.01, frequency = 1.0 }
profile = "power"
ramp = 0.1
[[outlets]]
wall = "right"
level = 0.1
fluid = "water"
[[vents]]
wall = "top"
open = [[0.1, 0.5], [1.0, 2.0]]
name = "chimney"
between = [[0.1, 0.3], [0.3, 0.3]]
[time]
end = 1.0
"""
)


def test_a_case_file_has_openings_and_is_written_back():
    case = read_case(GOOD, "case.toml").case()
    inlet, outlet, vent = case.openings
    assert (inlet.name, inlet.fluid, inlet.profile, inlet.ramp) == ("inlet_left", "water", "power", 0.1)
    assert inlet.discharge(0.25) == pytest.approx(0.01)
    assert (outlet.level, outlet.fluid, vent.name) == (0.1, "water", "chimney")
    text = str(describe(case, 1.0))
    again = read_case(text, "again.toml").case()
    assert again.openings == case.openings
    assert case.grounded


LAYERED = (
    GOOD.replace(
        'fluid = "water"\nbetween = [[0, 0], [0, 0.1]]',
        'fluid = { form = "stratified", fluids = ["water", "air"], bounds = [0.1] }',
    )
    .replace('profile = "power"', 'profile = { form = "polyline", points = [[0, 0.2], [0.1, 0.4], [0.3, 0.4]] }')
    .replace('level = 0.1\nfluid = "water"', 'pressure = { form = "ramp", end_value = 1000.0, end_time = 0.5 }')
)


def test_a_case_file_has_functions_of_openings_and_they_are_written_back():
    """Layers that enter together, a profile by points, and a pressure that rises."""
    case = read_case(LAYERED, "case.toml").case()
    inlet, outlet, _ = case.openings
    x = np.array([[0.0, 0.05], [0.0, 0.15]])
    assert inlet.entering(x, 0.0, ["water", "air"]).tolist() == [0, 1]
    assert inlet.shape(np.array([0.05, 0.2]), 0.3, 0.0, round_axis=False) == pytest.approx([0.3, 0.4])
    assert outlet.pressure_at(x, 0.25) == pytest.approx([500.0, 500.0])
    again = read_case(str(describe(case, 1.0)), "again.toml").case()
    assert again.openings == case.openings
    simulation = tp.Simulation(case, time_step=1e-3)
    simulation.step()
    enters = [simulation.history[-1][f"through_inlet_left_{name}"] for name in ("water", "air")]
    assert min(enters) > 0


@pytest.mark.parametrize("head", ["0.5", '{ form = "polyline", points = [[0, 0.6], [0.1, 0.2]] }'])
def test_a_pump_by_head_is_written_back(head):
    start, end = GOOD.index("discharge"), GOOD.index("[[vents]]")
    drain = '[[outlets]]\nwall = "right"\nname = "drain"\n'
    text = f'{GOOD[:start]}pump = "drain"\nhead = {head}\n{drain}{GOOD[end:]}'
    case = read_case(text, "case.toml").case()
    assert case.openings[0].raised(0.025, 0.0) == pytest.approx(0.5)
    assert read_case(str(describe(case, 1.0)), "again.toml").case().openings == case.openings
    assert "what leaves by drain, raised by" in Openings().lines(case)[0]
    with pytest.raises(CaseFileError, match=r"is 'drain', which has a level; a head sets the pressure of an outlet"):
        read_case(text.replace(drain, drain + 'level = 0.1\nfluid = "water"\n'), "case.toml")


def test_an_inlet_by_a_level_is_written_back():
    text = GOOD.replace(
        'discharge = { form = "sine", amplitude = 0.01, frequency = 1.0 }\nprofile = "power"\nramp = 0.1', "level = 0.2"
    )
    case = read_case(text, "case.toml").case()
    assert case.openings[0].level == 0.2
    assert read_case(str(describe(case, 1.0)), "again.toml").case().openings == case.openings
    assert "inlet_left: a level of 0.2 m, at right angles" in Openings().lines(case)[0]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"stratified", ', '"layered", ', "inlets[0].fluid.form is 'layered'; it must be one of 'stratified'"),
        ("bounds = [0.1]", "bounds = [0.1, 0.2]", "inlets[0].fluid.bounds has 2 items for 2 fluids; give one between"),
        (
            '["water", "air"]',
            '["water", "oil"]',
            "inlets[0].fluid.fluids is 'oil'; it must be one of the fluids 'water'",
        ),
        (
            "[0.3, 0.4]]",
            "[0.05, 0.4]]",
            "inlets[0].profile.points is [[0.0, 0.2], [0.1, 0.4], [0.05, 0.4]]; the",
        ),
        (
            "end_time = 0.5",
            "end_time = 0.5, start_time = 0.7",
            "outlets[0].pressure.end_time is 0.5 s; it must be later",
        ),
        ("end_value = 1000.0", "end_value = [1.0, 2.0]", "outlets[0].pressure.end_value has values of 2 number(s)"),
        (
            "fluid = { form",
            "fluid = 3.0 #",
            "inlets[0].fluid is 3.0; it must be a text in quotes or a table with",
        ),
    ],
)
def test_what_is_wrong_of_functions_of_openings_is_said(old, new, message):
    assert old in LAYERED
    with pytest.raises(CaseFileError) as error:
        read_case(LAYERED.replace(old, new), "case.toml").case()
    assert message in str(error.value)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[[inlets]]", "[[inflow]]", "inflow is not a known key; what flows in is in tables [[inlets]]"),
        ("[[outlets]]", "[[outflow]]", "outflow is not a known key; where fluids leave is in tables"),
        ("[[vents]]", "[[sponge]]", "sponge is not a known key; what damps waves is in tables [[beaches]]"),
        ("[[vents]]", "[[beaches]]", "beaches[0].length"),
        ("[[inlets]]", "[tank.motion]\n[[inlets]]", "tank.motion is not a known key; it is the table [tank_motion]"),
        ("[[vents]]", "[[pump]]", "pump is not a known key; a pump is an inlet, [[inlets]], whose key pump"),
        ("ramp = 0.1", "open = [1.0, 0.5]", "lists of 2 numbers in s; did you mean [[1.0, 0.5]]?"),
        ("[[inlets]]", "[inlets]", "inlets is a table; it must be a list of tables; begin each with [[inlets]]"),
        (
            '{ form = "sine", amplitude = 0.01, frequency = 1.0 }',
            '"0.05 m2/s"',
            "discharge is '0.05 m2/s'; it must be a number in m^2/s or a table with form = 'constant' or 'sine' or "
            "'ramp' or 'table'; numbers have no quotes and no unit, as 0.05",
        ),
        ("ramp = 0.1", "open = [[1.0, 0.5]]", "inlets[0].open is [[1.0, 0.5]]; it must be pairs of times"),
        (
            'fluid = "water"\nbetween',
            'fluid = "watr"\nbetween',
            "inlets[0].fluid is 'watr'; it must be one of the fluids 'water', 'air'; did you mean 'water'?",
        ),
        (
            "profile = ",
            "velocity = 1.0\nprofile = ",
            "inlets[0]: discharge and velocity are given; give one",
        ),
        ("level = 0.1\n", "", "outlets[0].level is left out; fluid is given, and a level needs both"),
        (
            "size = [0.4, 0.3]",
            'periodic = "x"\nsize = [0.4, 0.3]',
            "sides are periodic, with which openings do not work",
        ),
        (
            'wall = "left"',
            'wall = "lefft"',
            "inlets[0].wall is 'lefft'; it must be one of the walls 'left', 'right', 'bottom', 'top'; did you mean",
        ),
    ],
)
def test_mistakes_have_their_place(old, new, message):
    assert old in GOOD
    with pytest.raises(CaseFileError) as error:
        read_case(GOOD.replace(old, new, 1), "case.toml").case()
    assert message in str(error.value)


def test_all_mistakes_of_new_tables_are_told_at_once():
    wrong = [
        ('wall = "left"\nfluid', 'wall = "lefft"\nfluid', "inlets[0].wall is 'lefft'"),
        ('wall = "right"', 'wall = "rigth"', "outlets[0].wall is 'rigth'"),
        ('wall = "top"', 'wall = "tpo"', "vents[0].wall is 'tpo'"),
        ('level = 0.1\nfluid = "water"', 'level = 0.1\nfluid = "watr"', "outlets[0].fluid is 'watr'"),
        ("[time]", '[[beaches]]\nwall = "rigth"\nlength = 1\nperiod = 1\n[time]', "beaches[0].wall is 'rigth'"),
        ("[time]", "[surface_tension]\nwatr.air = 0.07\n[time]", "surface_tension.watr.air: there is no fluid 'watr'"),
        ("[time]", "[walls.bottom]\ncontact_angle = { watr = 20 }\n[time]", ""),
    ]
    text = GOOD
    for old, new, _ in wrong:
        assert old in text
        text = text.replace(old, new, 1)
    with pytest.raises(CaseFileError) as error:
        read_case(text, "case.toml")
    said = [message for *_, message in wrong if message]
    assert len(error.value.problems) == len(said)
    for message in said:
        assert message in str(error.value)
    hints = str(error.value).count("did you mean")
    assert hints == len(said)


def test_a_probe_of_an_opening_with_a_mistake_is_no_mistake_of_its_own():
    probe = '[[probes]]\ntype = "opening"\nname = "out"\nopening = "outlet_right"\nfluid = "water"\n[time]'
    text = GOOD.replace("[time]", probe).replace("level = 0.1", "level = 0.1\nbetween = [[0.1, 0.1], [0.2, 0.2]]")
    with pytest.raises(CaseFileError) as error:
        read_case(text, "case.toml").case()
    assert "outlets[0]" in str(error.value)
    assert "outlet_right" not in str(error.value)
    with pytest.raises(CaseFileError, match=r"'outlet_rihgt'; it must be one of .*; did you mean 'outlet_right'"):
        read_case(GOOD.replace("[time]", probe.replace("right", "rihgt")), "case.toml").case()


def test_what_flows_in_must_leave_before_particles_are_made():
    text = GOOD[: GOOD.index("[[outlets]]")] + "[time]\nend = 1.0\n"
    with pytest.raises(CaseFileError, match=r"inlets\[0\]: what flows in cannot leave; add a vent"):
        read_case(text, "case.toml")


def test_what_no_file_can_hold_is_said():
    tank = tp.tank((0.4, 0.3), 0.02).fill(tp.Fluid("water", 1000.0, 1e-3))
    water = tp.Fluid("water", 1000.0, 1e-3)
    outlet = tp.Outlet(wall="left", pressure=lambda x, t: 0 * x[:, 0])
    found = describe(tp.Case(tank, [water], (0, 0), openings=[outlet]), 1.0)
    assert any("outlets.outlet_left.pressure" in line for line in found.missing)


def test_check_says_what_passes(tmp_path, capsys):
    path = tmp_path / "case.toml"
    path.write_text(
        GOOD.replace('{ form = "sine", amplitude = 0.01, frequency = 1.0 }', "0.02").replace("ramp = 0.1", "")
    )
    assert main(["check", str(path), "--no-mesh"]) == 0
    said = capsys.readouterr().out
    assert "opening     inlet_left: water, 0.02 m^2/s, 0.2 m/s in the mean and" in said
    assert "0.1 m wide, 5 spacings; Froude number 0.2; Reynolds number 2e+04; the tank's volume in 6 s" in said
    assert "opening     outlet_right: a level of 0.1 m, freely; 0.3 m wide, 15 spacings" in said
    assert "opening     chimney: 0 Pa, at right angles; 0.2 m wide, 10 spacings; open 0.1 to 0.5 s, 1 to 2 s" in said
    assert "note: inlet_left sets off at" in said


@pytest.mark.slow
def test_two_liquids_that_slide_enter_and_leave_and_the_run_goes_on(tmp_path):
    """Their interface is carried out by the outlet, with cells of the lighter one."""
    path, out = tmp_path / "case.toml", tmp_path / "out"
    path.write_text(
        """\
gravity = [0, -9.81]
[fluids.brine]
density = 1200
viscosity = 2e-3
[fluids.oil]
density = 850
viscosity = 0.05
[tank]
size = [0.4, 0.2]
spacing = 0.02
[[fill]]
fluid = "oil"
[[fill]]
fluid = "brine"
box = [[0, 0], [0.4, 0.08]]
[[inlets]]
wall = "left"
fluid = { form = "stratified", fluids = ["brine", "oil"], bounds = [0.08] }
velocity = 0.3
[[outlets]]
wall = "right"
pressure = { form = "sine", amplitude = 200, frequency = 2, soft_start = 0.2 }
[time]
end = 0.16
largest_step = 4e-3
"""
    )
    assert main(["run", str(path), "--out", str(out), "--no-progress"]) == 0
    simulation = tp.Simulation.resume(out)
    assert "sliding_liquids" in simulation.state.parts
    assert sum(row["through_outlet_right_oil"] for row in simulation.history) < 0
    assert main(["resume", str(out), "--until", "0.168", "--no-progress"]) == 0
