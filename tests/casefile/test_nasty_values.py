"""Values that nobody means, anywhere in a case file: it is refused by a `CaseFileError`, or makes a case."""

import contextlib
import copy
import random

import pytest
from test_bad_input import GOOD

from tipfem.casefile.describing import _key, toml_value
from tipfem.casefile.loading import read_case
from tipfem.casefile.problems import CaseFileError
from tipfem.casefile.source import parse, paths_of

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
