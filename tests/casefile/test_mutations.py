"""Damaged case files, 500 of them: each is refused in one report, or is a case that says what its file says."""

import math
import random

import pytest
from demo_runs import DEMOS
from mutations import mutated
from test_nasty_values import MORE

from tipfem.casefile.loading import read_case
from tipfem.casefile.problems import CaseFileError

MUTATIONS, GROUPS = 500, 10
TEXTS = [MORE, *(path.read_text("utf-8") for path in sorted((DEMOS / "cases").glob("*.toml")))]


def is_small(table):
    """Whether the particles of a case are quickly made: a damaged size can ask for millions."""
    tank = table.tank
    return tank is not None and (tank.size is None or math.prod(tank.size) < 1e5 * tank.spacing ** len(tank.size))


def as_lists(value):
    if isinstance(value, dict):
        return {key: as_lists(item) for key, item in value.items()}
    return [as_lists(item) for item in value] if isinstance(value, list | tuple) else value


@pytest.mark.parametrize("group", range(GROUPS))
def test_a_damaged_file_is_refused_or_means_what_it_says(group):
    made = 0
    for number in range(group, MUTATIONS, GROUPS):
        rng = random.Random(number)
        text = mutated(rng, rng.choice(TEXTS))
        refused = ""
        try:
            file = read_case(text, "case.toml")  # any error but a report fails the test
            if made < 1 and is_small(file.table):  # making the particles takes a while
                made += 1
                file.case()
        except CaseFileError as error:
            refused = str(error)
        assert "object at 0x" not in refused
        assert all(line.startswith("case.toml") for line in refused.splitlines()), refused
        if not refused:
            assert as_lists(file.table.model_dump(exclude_unset=True)) == file.data
