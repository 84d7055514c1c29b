"""One message for one mistake, which names what was meant."""

from __future__ import annotations

import pytest

import tipfem as tp
from tipfem.arguments import closest
from tipfem.casefile.loading import read_case
from tipfem.casefile.problems import CaseFileError

GOOD = """gravity = [0, -9.81]
[fluids.water]
density = 998.2
viscosity = 1e-3
[tank]
size = [1, 1]
spacing = 0.05
[[fill]]
fluid = "water"
[[bodies]]
name = "gate"
box = [[0.4, 0.4], [0.6, 0.6]]
motion = { translation = { form = "ramp", start_value = [0, 0], end_value = [0, 0.1], start_time = 0, end_time = 1 } }
[walls.left]
law = "no-slip"
[time]
end = 1
largest_step = 1e-3
[output]
interval = 0.1
"""


def messages(old="", new="", *overrides):
    assert old in GOOD
    with pytest.raises(CaseFileError) as error:
        read_case(GOOD.replace(old, new), "case.toml", overrides=overrides)
    return [str(problem) for problem in error.value.problems]


def test_the_case_is_good():
    assert read_case(GOOD, "case.toml").case().bodies[0].name == "gate"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("start_time = 0", "start_time = 2", "translation.end_time is 1.0 s; it must be later than start_time, 2.0 s"),
        ("translation =", "translaton =", "translaton is not a known key; did you mean 'translation'?"),
        ("density", "densty", "fluids.water.densty is not a known key; did you mean 'density'?"),
        ("spacing =", "spaceing =", "tank.spaceing is not a known key; did you mean 'spacing'?"),
        ("largest_step = 1e-3", "largest_step = 2", "largest_step is 2 s; it must be at most 0.71 s, 10 sqrt(h / |b|)"),
        ("interval = 0.1", "interval = 1e-5", "output.interval is 1e-05 s, far below time.largest_step, 0.001 s; it"),
    ],
)
def test_a_mistake_has_one_message(old, new, message):
    (found,) = messages(old, new)
    assert message in found


def test_a_motion_without_content_is_one_of_the_body():
    start, _, rest = GOOD.partition("motion = ")
    with pytest.raises(CaseFileError) as error:
        read_case(f"{start}motion = {{}}\n{rest.partition(chr(10))[2]}", "case.toml")
    (found,) = error.value.problems
    assert str(found) == ("case.toml:13: bodies[0].motion has neither translation nor angle; give one, or leave it out")


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("fluids.watr.density=3", "--set fluids.watr.density=3: there is no fluid 'watr'; did you mean 'water'?"),
        ("walls.lefft.law=slip", "--set walls.lefft.law=slip: there is no wall 'lefft'; did you mean 'left'?"),
        (
            "tank.spaceing=1",
            "--set tank.spaceing=1: tank.spaceing is not a known key; did you mean",
        ),
    ],
)
def test_a_misspelt_path_of_an_override_is_named(override, message):
    (found,) = messages("", "", override)
    assert found.startswith(message)


def test_an_unknown_key_has_its_nearest_matches_and_all_keys_where_there_is_none():
    (near,) = messages("largest_step = 1e-3", "largest_step = 1e-3\n[numerics]\nnewton_iteration = 3")
    assert near.endswith("is not a known key; did you mean 'newton_iterations'?")
    assert closest("colum", ["volume", "columns", "column"]) == ["column", "columns"]
    (inner,) = messages("largest_step = 1e-3", "largest_step = 1e-3\n[numerics]\ntoo_close = 0.5")
    assert inner.endswith("is not a known key; there is one in numerics.relocation and numerics.fitting")
    (none,) = messages("", "", "numerics.xyz=1")
    assert "is not a known key; the keys here are rho_inf, stabilisation, " in none


def test_all_bodies_without_room_are_told_together():
    body = '[[bodies]]\nname = "{}"\nbox = [[{}, 0.4], [{}, 0.6]]\n'
    close = "".join(body.format(*given) for given in (("a", 0.05, 0.3), ("b", 0.7, 0.95)))
    with pytest.raises(CaseFileError) as error:
        read_case(GOOD.replace("[walls.left]", f"{close}[walls.left]"), "case.toml").case()
    first, second = map(str, error.value.problems)
    assert first.startswith(
        "case.toml:14: bodies[1]: it is 0.05 m away from the wall 'left' at [0.05, 0.4] m; it must be"
    )
    assert "0.15 m or more (3 spacings) off all walls and other bodies" in first
    assert second == (
        "case.toml:17: bodies[2]: it is 0.05 m away from the wall 'right' at [0.95, 0.4] m; it must be 0.15 m or more "
        "off it"
    )
    water = tp.Fluid("water", density=1000.0, viscosity=1e-3)
    tank = tp.tank((1, 1), 0.05).fill(water)
    for name, x in (("a", 0.05), ("b", 0.75)):
        tank.add(tp.Body(tp.shapes.rectangle((x, 0.4), (x + 0.2, 0.6)), name=name))
    with pytest.raises(ValueError, match=r"tank: body 'a': .*\ntank: body 'b': "):
        tp.Case(tank, [water], gravity=(0, -9.81))


def test_new_names_in_overrides_stay_possible():
    file = read_case(GOOD, "case.toml", overrides=["walls.right.slip=true", "fluids.air={density=1.2, viscosity=1e-5}"])
    assert [fluid.name for fluid in file.case().fluids] == ["water", "air"]


def test_python_says_what_is_right():
    with pytest.raises(ValueError, match=r"density is '1000', a text; it must be a number > 0 .*, without quotes"):
        tp.Fluid("water", density="1000", viscosity=1e-3)
    with pytest.raises(TypeError, match=r"positional arguments; say tank\(size=\(0.584, 0.584\), spacing=0.02\)"):
        tp.tank(0.584, 0.584, 0.02)
    water = tp.Fluid("water", density=1000.0, viscosity=1e-3)
    case = tp.Case(tp.tank((0.4, 0.4), 0.08).fill(water), [water], gravity=(0, -9.81))
    with pytest.raises(ValueError, match=r"time step is 10 s; it must be at most 0.9 s, 10 sqrt\(h / \|b\|\)"):
        tp.Simulation(case, time_step=10, output_interval=0.004)
    with pytest.raises(TypeError, match=r"missing a required argument: 'until'; say run\(until=0.4\)"):
        tp.Simulation(case).run()
