"""Notes on what may be a mistake of units or signs, and the scales of the flow."""

from __future__ import annotations

import math
import warnings
from pathlib import Path

import pytest
from demo_runs import DEMOS

import tipfem as tp
from tipfem.app.commands import main
from tipfem.casefile.estimate import largest_speed
from tipfem.casefile.hints import hints, scales

CASE = str(DEMOS / "cases" / "dam_break.toml")
COARSE = ("--set", "tank.spacing=0.02")


def made(**fluids):
    file = tp.load_case(CASE, ["tank.spacing=0.02", *(f"fluids.{name}={value}" for name, value in fluids.items())])
    return file.case()


def test_a_drop_without_gravity_is_said_to_move():
    fluids = [tp.Fluid("water", 1000.0, 1e-3), tp.Fluid("air", 1.0, 1e-5)]
    tank = tp.tank((0.01, 0.01), 0.001).fill(fluids[1]).fill(fluids[0], disc=((0.005, 0.005), 0.002))
    assert scales(tp.Case(tank, fluids, (0, 0))) == "nothing moves at the start, and there is no gravity"
    line = scales(tp.Case(tank, fluids, (0, 0), surface_tension={("water", "air"): 0.07}))
    assert line.startswith("forces other than gravity")
    assert "0.0011 s" in line


def test_a_sound_case_has_no_hints():
    assert hints(made(), 0.4, 0.004) == []


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["fluids.water.density=0.9982"], "water (0.9982 kg/m^3) is lighter than air (1.204) and lies below it"),
        (
            ["fluids.water.viscosity=1410"],
            "kinematic viscosity of 1.4 m^2/s, outside of 1e-07 to 0.1; is it in Pa s?",
        ),
        (["fluids.water.density=998200"], "water has 998200 kg/m^3, not 0.01 to 20000; is the unit right?"),
        (["gravity=[0, 9.81]"], "gravity is [0.0, 9.81] m/s^2, which is upwards; -9.81 is downwards"),
        (["gravity=[0, -981]"], "gravity is 981 m/s^2; that of the Earth is 9.81"),
        (["output.interval=10"], "states are to be written every 10 s, and the run is 0.4 s long"),
    ],
)
def test_check_notes_what_looks_wrong(words, expected, capsys):
    options = [option for word in words for option in ("--set", word)]
    assert main(["check", CASE, *COARSE, *options, "--no-mesh"]) == 0
    notes = [line for line in capsys.readouterr().out.splitlines() if line.startswith("note: ")]
    assert [line for line in notes if expected in line], notes
    assert len(notes) <= 3


def test_check_says_what_of_a_fill_is_outside(capsys):
    box = "fill.1.box=[[0, 0], [0.146, 2]]"
    assert main(["check", CASE, *COARSE, "--no-mesh"]) == 0
    assert "left out" not in capsys.readouterr().out
    assert main(["check", CASE, *COARSE, "--set", box, "--no-mesh"]) == 0
    (note,) = (line for line in capsys.readouterr().out.splitlines() if "left out" in line)
    assert note == (
        "note: fill[1] of water reaches from [0, 0] to [0.146, 2] m, out of the tank from [0, 0] to [0.584, 0.584] m; "
        "what is outside is left out"
    )


def test_tension_in_the_wrong_unit_is_noted():
    file = tp.load_case(CASE, ["tank.spacing=0.02", "surface_tension.water.air=72.8"])
    (note,) = hints(file.case(), 0.4, 0.004)
    assert note.startswith("surface tension of water and air is 72.8 N/m; no liquid has more than 3; is it in N/m?")


def test_small_tanks_without_tension_and_angles_in_radians_are_noted():
    water, air = tp.Fluid("water", 1000.0, 1e-3), tp.Fluid("air", 1.2, 1.8e-5)

    def notes(size, tension=None, angle=None):
        tank = tp.tank((size, size), size / 8).fill(air).fill(water, box=((0, 0), (size, size / 2)))
        if angle is not None:
            tank.wall("bottom", contact_angle={("water", "air"): angle})
        options = {} if tension is None else {"surface_tension": {("water", "air"): tension}}
        return hints(tp.Case(tank, [water, air], (0, -9.81), **options), 1e-3, None)

    (note,) = notes(3e-4)
    assert note.startswith("the tank is 0.0003 m wide or high, less than the 0.0027 m below which tension")
    assert notes(3e-4, 0.07) == notes(0.01) == notes(0.01, 0.07, 60.0) == notes(0.01, 0.07, (30.0, 60.0)) == []
    assert notes(0.01, 0.07, 1.2) == [
        "wall 'bottom' has a contact_angle of 1.2 degrees; is it in degrees? 1.2 rad are 68.8"
    ]


def test_waves_and_beaches_that_do_not_fit_are_noted():
    water, air = tp.Fluid("water", 1000.0, 1e-3), tp.Fluid("air", 1.2, 1.8e-5)
    tank = tp.tank((2.0, 0.4), 0.04).fill(air).fill(water, box=((0, 0), (2.0, 0.2)))
    tank.wall("left", slip=True, motion=tp.WavePiston(height=0.02, period=1.0, depth=0.4))
    beaches = [tp.Beach(wall="left", length=1.0, period=1.0), tp.Beach(wall="right", length=0.5, period=1.0)]
    case = tp.Case(tank, [water, air], (0, -9.81), openings=[tp.Vent(wall="top")], beaches=beaches)
    notes = hints(case, 1.0, None)
    assert "waves of wall 'left' are for a depth of 0.4 m; water has 0.2 m" in notes
    assert "the beach at 'left' damps the waves where they are made" in notes
    assert "the beach at 'right' is 0.5 m long; a beach should have 1.5 wave lengths, 2.2 m" in notes


@pytest.mark.parametrize("what", ["piston", "no-slip", "slip length"])
def test_walls_that_move_where_no_fluid_is_are_noted(what):
    """A piston or a drum above the water, until that reaches it; walls that rest there are not."""
    water = tp.Fluid("water", 1000.0, 1e-3)

    def notes(level):
        if what == "piston":
            tank = tp.tank((1.0, 0.8), 0.05).wall("top", motion=lambda t: 0.01 * t**2)
        else:
            drum = tp.shapes.circle((0.5, 0.5), 0.15)
            shape = tp.shapes.polygon([(0, 0), (1, 0), (1, 0.8), (0, 0.8)], holes=[drum])
            tank, options = tp.tank(shape=shape, spacing=0.05), {"slip_length": 0.01} if what == "slip length" else {}
            tank.wall("side4", velocity=0.1, **options)
        case = tp.Case(tank.fill(water, box=((0, 0), (1, level))), [water], (0, -9.81), free_surface=True)
        return [line for line in hints(case, 1.0, None) if "no fluid is at it" in line]

    (line,) = notes(0.2)
    assert line.startswith(f"wall {'top' if what == 'piston' else 'side4'!r} moves, and no fluid is at it at the start")
    assert notes(0.8 if what == "piston" else 0.5) == []


def test_run_notes_it_too(tmp_path, capsys):
    words = ["--set", "output.interval=10", "--until", "0.002", "--out", str(tmp_path), "--no-progress"]
    assert main(["run", CASE, *COARSE, *words]) == 0
    assert "note: states are to be written every 10 s" in capsys.readouterr().err


def test_the_scales_are_those_of_the_column():
    """Water of 0.292 m that falls: the speed is sqrt(2 g H), and the Reynolds number U H / nu."""
    line = scales(made())
    speed = math.sqrt(2 * 9.81 * 0.292)
    assert f"up to {speed:.2g} m/s" in line
    assert f"Reynolds number up to {speed * 0.292 / (1.002e-3 / 998.2):.1e}" in line
    assert "15 spacings over 0.292 m of water, which does not resolve boundary layers" in line
    assert "which resolves boundary layers" in scales(made(**{"water.viscosity": 100.0}))


def test_levels_above_their_openings_and_vents_in_liquids_are_noted():
    water, air = tp.Fluid("water", 1000.0, 1e-3), tp.Fluid("air", 1.2, 1.8e-5)
    tank = tp.tank((0.4, 0.4), 0.04).fill(air).fill(water, box=((0, 0), (0.4, 0.2)))
    openings = [
        tp.Outlet(wall="right", between=((0.4, 0), (0.4, 0.2)), level=0.3, fluid=water),
        tp.Vent(wall="bottom", between=((0.0, 0.0), (0.2, 0.0))),
        tp.Vent(wall="top", between=((0.0, 0.4), (0.2, 0.4))),
        tp.Inlet(wall="left", between=((0, 0), (0, 0.16)), fluid=water, velocity=9.0, ramp=0.1),
    ]
    case = tp.Case(tank, [water, air], (0, -9.81), openings=openings)
    assert hints(case, 1.0, None) == [
        "outlet_right has a level of 0.3 m, above its upper end at 0.2 m: it is drowned, and only its own fluid enters",
        "vent_bottom is in water at the start, which leaves by it; vents are for gases",
    ]
    assert largest_speed(case) >= 9.0


def test_a_tension_that_is_not_given_is_noted_where_a_fluid_would_spread():
    water, oil, air = (tp.Fluid(name, density, 1e-3) for name, density in (("water", 1e3), ("oil", 900), ("air", 1)))
    tank = tp.tank((1, 1), 0.1).fill(air).fill(water, box=((0, 0), (1, 0.3))).fill(oil, box=((0, 0.3), (1, 0.6)))
    given = {("water", "air"): 0.07, ("oil", "air"): 0.03, ("water", "oil"): 0.05}
    notes = {}
    for left_out in [None, *given]:
        table = {pair: value for pair, value in given.items() if pair != left_out}
        notes[left_out] = hints(tp.Case(tank, [water, oil, air], (0, -9.81), surface_tension=table), 1.0, None)
    words = "surface tension of the interface of {} is not given and counts as 0; where all three meet, {} without end"
    assert notes[None] == []
    assert notes["water", "oil"] == [words.format("oil and water", "oil would spread between water and air")]
    assert notes["oil", "air"] == [words.format("oil and air", "oil would spread between water and air")]
    assert notes["water", "air"] == [words.format("air and water", "air would spread between water and oil")]
    drop = tp.tank((1, 1), 0.1).fill(water, box=((0, 0), (1, 0.3))).fill(oil, box=((0, 0.3), (1, 0.6)))
    case = tp.Case(drop, [water, oil], (0, -9.81), free_surface=True, surface_tension={"water": 0.07, "oil": 0.03})
    assert hints(case, 1.0, None) == [words.format("oil and water", "oil would spread between water and empty space")]


def test_a_reservoir_that_is_the_only_opening_of_a_full_tank_is_noted():
    water, air = tp.Fluid("water", 1000.0, 1e-3), tp.Fluid("air", 1.2, 1.8e-5)
    tank = tp.tank((0.4, 0.4), 0.04).fill(air).fill(water, box=((0, 0), (0.4, 0.2)))
    reservoir, vent = tp.Inlet(wall="left", fluid=water, level=0.3), tp.Vent(wall="top", between=((0, 0.4), (0.2, 0.4)))
    text = "inlet_left is the only opening of a full tank: as much leaves by it as enters; add a vent or an outlet"
    assert text in hints(tp.Case(tank, [water, air], (0, -9.81), openings=[reservoir]), 1.0, None)
    assert hints(tp.Case(tank, [water, air], (0, -9.81), openings=[reservoir, vent]), 1.0, None) == []
    alone = tp.Case(
        tp.tank((0.4, 0.4), 0.04).fill(water, box=((0, 0), (0.4, 0.2))), [water], (0, -9.81), free_surface=True
    )
    assert hints(alone, 1.0, None) == []


def speed_of(*openings):
    water = tp.Fluid("water", 1000.0, 1e-3)
    tank = tp.tank((0.8, 0.4), 0.04).fill(water, box=((0, 0), (0.8, 0.2)))
    return tp.Case(tank, [water], (0, -10.0), openings=openings, free_surface=True).entering_speed()


def test_pumps_and_reservoirs_have_a_largest_speed():
    drain = {"wall": "bottom", "between": ((0.2, 0), (0.4, 0)), "name": "drain"}
    up = {"wall": "left", "between": ((0, 0), (0, 0.16)), "fluid": "water", "pump": "drain"}
    # 0.2 m^2/s through 0.16 m; a head of 0.45 m; the surface is 0.2 m above the drain, which is wider than the inlet.
    assert speed_of(tp.Inlet(fluid="water", discharge=-0.2, **drain), tp.Inlet(**up)) == pytest.approx(1.25)
    assert speed_of(tp.Outlet(**drain), tp.Inlet(**up, head=0.45)) == pytest.approx(3.0 * 0.2 / 0.16)
    assert speed_of(tp.Outlet(**drain), tp.Inlet(**up)) == pytest.approx(2.0 * 0.2 / 0.16, rel=1e-6)
    level = tp.Inlet(wall="left", between=((0, 0), (0, 0.16)), fluid="water", level=0.8)
    assert speed_of(level) == pytest.approx(4.0)


LIFT = (0.0, 0.5)


@pytest.mark.parametrize(
    ("fluids", "free_surface", "velocity", "said"),
    [
        (2, False, LIFT, True),
        (1, True, LIFT, True),
        (2, False, lambda _: LIFT, True),
        (2, False, -0.5, True),
        (2, False, lambda t: 0.5 * min(t, 1.0), True),
        (1, False, LIFT, False),
        (2, False, (0.0, 0.0), False),
        (1, True, 0.0, False),
    ],
)
def test_surfaces_at_walls_that_slide_are_noted(fluids, free_surface, velocity, said):
    """And a simulation warns of them, at the line that makes it."""
    water, air = tp.Fluid("water", 1000.0, 1e-3), tp.Fluid("air", 1.0, 1e-5)
    tank = tp.tank((0.4, 0.4), 0.04)
    if fluids == 2:
        tank.fill(air)
    full = fluids == 1 and not free_surface
    tank.fill(water) if full else tank.fill(water, box=((0, 0), (0.4, 0.2)))
    tank.wall("right", velocity=velocity)
    case = tp.Case(tank, [water, air][:fluids], (0, -9.81), free_surface=free_surface)
    start = "wall 'right' slides along itself: surfaces follow it by less"
    assert [line.startswith(start) for line in hints(case, 1.0, None)] == [True] * said
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        tp.Simulation(case)
    assert [str(each.message).startswith(start) for each in found] == [True] * said
    assert all(each.filename == __file__ for each in found)


@pytest.mark.parametrize(
    ("interface", "viscosity", "words"),
    [
        (
            "sharp",
            1e-3,
            "stay where they are, for the film of 0.00023 m of water that it draws out is thinner than a spacing",
        ),
        ("sharp", 40.0, None),
        ("interpolated", 40.0, "by less than they should; the wall's particles stay where they are"),
    ],
)
def test_what_surfaces_at_sliding_walls_do_is_said(interface, viscosity, words):
    """A film that a wall draws out is sqrt(nu U / g) thick."""
    water, air = tp.Fluid("water", 1000.0, viscosity), tp.Fluid("air", 1.0, 1e-5)
    tank = tp.tank((0.4, 0.4), 0.04).fill(air).fill(water, box=((0, 0), (0.4, 0.2))).wall("right", velocity=LIFT)
    case = tp.Case(tank, [water, air], (0, -9.81), interface=interface)
    found = [line for line in case.doubts() if "slides along itself" in line]
    assert len(found) == (words is not None)
    assert words is None or words in found[0]


def test_a_command_says_a_note_once(tmp_path, capfd):
    text = Path(CASE).read_text(encoding="utf-8") + "\n[walls.right]\nvelocity = [0.0, 0.5]\n"
    (tmp_path / "case.toml").write_text(text, encoding="utf-8")
    assert main(["check", str(tmp_path / "case.toml"), *COARSE]) == 0
    assert "".join(capfd.readouterr()).count("slides along itself") == 1


@pytest.mark.parametrize(
    ("options", "words", "said"),
    [
        ({}, [], True),
        ({"impulse": True}, [], False),
        ({"time_constant": 2e-3}, [], False),
        ({}, ["numerics.largest_move=0.5"], False),
    ],
)
def test_pressures_of_single_long_steps_are_noted(options, words, said):
    case = tp.load_case(CASE, ["tank.spacing=0.02", *words]).case()
    gauge = tp.WallPressure(name="gauge", wall="right", at=(0.584, 0.02), **options)
    found = hints(case, 0.4, 0.004, [gauge, tp.FrontProbe(name="front", fluid="water")])
    assert [line.startswith("loads of 'gauge' are those of single steps, of up to 2 spacings") for line in found] == [
        True
    ] * said
