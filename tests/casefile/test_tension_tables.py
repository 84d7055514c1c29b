"""Surface tension in case files: read, checked and written back."""

from __future__ import annotations

import pytest
from case_texts import WATER_IN_AIR

from tipfem.casefile.describing import describe
from tipfem.casefile.loading import read_case
from tipfem.casefile.problems import CaseFileError

CASE = (
    WATER_IN_AIR
    + """\
box = [[0, 0], [0.1, 0.2]]
[surface_tension]
water.air = 0.0728
[time]
end = 0.1
"""
)


def test_a_case_file_keeps_the_tension():
    case = read_case(CASE, "case.toml").case()
    assert case.surface_tension.given == {("water", "air"): 0.0728}
    again = read_case(describe(case, 0.1).text, "again.toml").case()
    assert again.surface_tension.given == case.surface_tension.given


def test_a_free_surface_has_one_fluid():
    free = "free_surface = true\n" + CASE.replace("water.air", "water").replace('[[fill]]\nfluid = "air"\n', "")
    free = free.replace("[fluids.air]\ndensity = 1.2\nviscosity = 1.8e-5\n", "")
    case = read_case(free, "case.toml").case()
    assert case.surface_tension.given == {"water": 0.0728}
    assert read_case(describe(case, 0.1).text, "again.toml").case().surface_tension.given == {"water": 0.0728}


def test_two_fluids_below_a_free_surface_have_three_tensions():
    three = "free_surface = true\n" + CASE.replace(
        "water.air = 0.0728", "water = { surface = 0.0728, air = 0.045 }\nair = 0.03"
    )
    case = read_case(three, "case.toml").case()
    assert case.surface_tension.given == {"water": 0.0728, ("water", "air"): 0.045, "air": 0.03}
    again = read_case(describe(case, 0.1).text, "again.toml").case()
    assert again.surface_tension.given == case.surface_tension.given


def test_a_tension_with_a_fluid_that_is_not_there_is_one_mistake():
    text = "free_surface = true\n" + CASE.replace("water.air", "water.oil").replace('[[fill]]\nfluid = "air"\n', "")
    with pytest.raises(CaseFileError) as error:
        read_case(text, "case.toml")
    (found,) = error.value.problems
    assert "there is no fluid 'oil'; the fluids are water, air" in str(found)


@pytest.mark.parametrize(
    ("line", "text"),
    [
        ("water.air = -1", "surface_tension.water.air is -1 N/m; it must be a number >= 0 in N/m"),
        ('water.air = "0.07"', "surface_tension.water.air is '0.07'; it must be a number >= 0 in N/m"),
        ("water.oil = 1", "surface_tension.water.oil: there is no fluid 'oil'; the fluids are water, air"),
        (
            "watr.air = 1",
            "surface_tension.watr.air: there is no fluid 'watr'; the fluids are water, air; did you mean 'water'?",
        ),
        ("water = 1", "surface_tension.water: there is no free surface"),
        ("water.water = 1", "surface_tension.water.water: the same fluid twice"),
        ("water.air = 1\nair.water = 1", "surface_tension.air.water: it is given twice"),
    ],
)
def test_mistakes_have_their_line(line, text):
    with pytest.raises(CaseFileError) as error:
        read_case(CASE.replace("water.air = 0.0728", line), "case.toml")
    assert text in str(error.value)
    assert str(error.value).startswith(f"case.toml:{18 + line.count(chr(10))}: ")
    assert len(error.value.problems) == 1


def test_an_angle_is_checked_before_particles_are_made():
    angle = "[walls.bottom.contact_angle]\nwater.oil = 60\n[walls.left.contact_angle]\nair.water = 60\n"
    with pytest.raises(CaseFileError) as error:
        read_case(CASE + angle, "case.toml")
    (found,) = error.value.problems
    text = "contact_angle.water.oil: without surface tension a contact angle has no meaning, and the interface of water"
    assert f"{text} and oil has none; surface_tension gives it to the interface of water and air" in str(found)


def test_an_interpolated_interface_is_refused():
    with pytest.raises(CaseFileError, match="needs interface = 'sharp'"):
        read_case('interface = "interpolated"\n' + CASE, "case.toml")
