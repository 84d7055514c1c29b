"""Values that nobody means, anywhere in a case file: it is refused by a `CaseFileError`, or makes a case."""

import contextlib
import copy
import random

import pytest
from case_texts import paths_of
from test_bad_input import GOOD

from tipfem.casefile.describing import _key, toml_value
from tipfem.casefile.loading import read_case
from tipfem.casefile.problems import CaseFileError
from tipfem.casefile.source import parse

MORE = (
    GOOD
    + """
[tank_motion]
angle = { form = "sine", amplitude = 0.1, frequency = 1.0 }
pivot = [0, 0]

[numerics.fitting]
thin_film = 0.3

[[grading.limits]]
box = [[0, 0], [1, 1]]
largest = 0.02
"""
)
VALUES = [
    *(0, -1, 1, 2, 0.5, True, 1e-300, 1e300, 10**400, -(10**400), 1e-9, "", "water", "air", "x\0y", "\n", "sharp"),
    *([], [1], [1, 2], [1, 2, 3], [[0, 0], [1, 1]], [[]], [[0], [0, 1]], [10**400, 1], [10**30], [0.0, 0.0], [{}], {}),
    {"form": "sine"},
    {"form": "sine", "amplitude": 1e308, "frequency": 1e-300},
    {"form": "table", "times": [0, 1, 2], "values": [[1, 2], 3, [1, 2, 3]]},
    {"form": "ramp", "end_value": [1, 0], "end_time": 1e-300},
    {"form": "constant", "value": 10**400},
    {"a": {"b": {}}},
    [{"fluid": "air"}],
]
KEYS = ["x", "box", "disc", "polygon", "below", "velocity", "motion", "slip", "between", "particles", "columns", "seed"]


@pytest.mark.parametrize("seed", range(40))
def test_nasty_values_end_in_a_case_or_one_report(seed):
    rng = random.Random(seed)
    for _ in range(3):
        data = copy.deepcopy(parse(MORE).data)
        for _ in range(rng.choice([1, 1, 2, 3])):
            path = rng.choice(sorted(paths_of(data), key=str))
            node = data
            for key in path[:-1]:
                node = node[key]
            new = rng.choice(KEYS) if isinstance(node, dict) and rng.random() < 0.15 else path[-1]
            node[new] = copy.deepcopy(rng.choice(VALUES))
        text = "\n".join(f"{_key(key)} = {toml_value(value)}" for key, value in data.items())
        with contextlib.suppress(CaseFileError):  # any other error fails the test
            read_case(text, "case.toml").case()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("end = 1.0", "end = " + "[" * 5000 + "]" * 5000, "nested more than 20 deep"),
        ("end = 1.0", "end = " + "{a = " * 900 + "1" + "}" * 900, "nested more than 20 deep"),
        ("[time]", "[" + ".".join("a" * 5000) + "]\nb = 1\n[time]", "nested more than 20 deep"),
        ("998.2", "9" * 5000, "case.toml:6: this is not valid TOML: a number has thousands of digits"),
        ("998.2", "9" * 400, "case.toml:6: fluids.water.density is 9999"),
        ("spacing = 0.02", "spacing = 1e-300", "tank.spacing is 1e-300 m, far too small"),
        ("size = [0.3, 0.2]", "size = [1e300, 1e300]", "tank.spacing is 0.02 m, far too small"),
    ],
)
def test_what_is_beyond_all_bounds_is_refused(old, new, message):
    with pytest.raises(CaseFileError) as error:
        read_case(GOOD.replace(old, new, 1), "case.toml").case()
    assert message in str(error.value)


@pytest.mark.parametrize("text", ["tank.spacing=" + "[" * 5000, ".".join("a" * 5000) + "=1"])
def test_overrides_beyond_all_bounds_are_refused(text):
    with pytest.raises(CaseFileError):
        read_case(GOOD, "case.toml", overrides=[text])


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "title =",
            "turbulence = 'k-epsilon'\ntitle =",
            "case.toml:1: turbulence is not in tipfem: there is no",
        ),
        (
            "spacing = 0.02",
            "spacing = 0.02\nstl = 'a.stl'",
            "case.toml:16: tank.stl is not in tipfem: there are boxes",
        ),
        ("[walls.top]", "[walls.sink]", "case.toml:24: walls.sink is not in tipfem: nothing makes or takes"),
        ("[[probes]]", "[gate]\n[[probes]]", "gate is not in tipfem: no wall opens"),
        (
            "density = 998.2",
            "density = 998.2\ntemperature = 20",
            "water.temperature is not in tipfem: there is no",
        ),
    ],
)
def test_what_tipfem_does_not_have_is_said(old, new, message):
    with pytest.raises(CaseFileError, match="What it cannot do") as error:
        read_case(GOOD.replace(old, new, 1), "case.toml")
    assert message in str(error.value)


def test_what_stands_elsewhere_is_said():
    text = GOOD.replace("density = 998.2", "density = 998.2\nsurface-tension = 0.07", 1)
    with pytest.raises(CaseFileError, match=r"surface-tension is not a known key.* in the table surface_tension, as"):
        read_case(text, "case.toml")


@pytest.mark.parametrize("old", ['interface = "sharp"', "free_surface = true"])
def test_a_contradiction_has_its_line_and_the_words_of_the_file(old):
    new = 'interface = "interpolated"'
    new += "\nfree_surface = true" if "free" in old else ""
    text = GOOD.replace('interface = "sharp"', new, 1).replace("[grading]\nlargest = { air = 0.04 }\n", "")
    with pytest.raises(CaseFileError) as error:
        read_case(text.replace("largest_move = 0.5", 'pressure = "two-sided"'), "case.toml").case()
    (problem,) = error.value.problems
    assert str(problem).startswith(f"case.toml:{30 if 'free' in old else 29}: numerics.pressure is 'two-sided'; ")
    assert "Numerics(" not in str(problem)
