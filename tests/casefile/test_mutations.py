"""Damaged case files, 500 of them: each is refused in one report, or is a case that says what its file says."""

import random
import re

import pytest
from demo_runs import DEMOS
from test_nasty_values import MORE

from tipfem.casefile.loading import read_case
from tipfem.casefile.problems import CaseFileError

MUTATIONS, GROUPS = 500, 10
TEXTS = [MORE, *(path.read_text("utf-8") for path in sorted((DEMOS / "cases").glob("*.toml")))]
NUMBER = re.compile(r"(?<![\w\".])-?\d+(?:\.\d+)?(?:e-?\d+)?(?![\w\"])")
WORD = re.compile(r"[a-z_]{3,}")
VALUES = [
    "0",
    "-1",
    "1e-300",
    "1e300",
    "nan",
    "-inf",
    "true",
    '""',
    "[]",
    "{}",
    "[[1, 2], [3]]",
    "9" * 400,
    "1.5",
    "0x10",
]
CHARACTERS = "[]{}=\"'.,#\n\\ 0aé\t\0"


def number_replaced(rng, text):
    found = rng.choice(list(NUMBER.finditer(text)))
    return text[: found.start()] + rng.choice(VALUES) + text[found.end() :]


def word_exchanged(rng, text):
    one, other = rng.sample(list(WORD.finditer(text)), 2)
    return text[: one.start()] + other[0] + text[one.end() :]


def letter_lost(rng, text):
    at = rng.randrange(len(text))
    return text[:at] + text[at + 1 :]


def character_added(rng, text):
    at = rng.randrange(len(text))
    return text[:at] + rng.choice(CHARACTERS) + text[at:]


def line_lost(rng, text):
    lines = text.splitlines(keepends=True)
    del lines[rng.randrange(len(lines))]
    return "".join(lines)


def line_moved(rng, text):
    lines = text.splitlines(keepends=True)
    line = lines.pop(rng.randrange(len(lines)))
    lines.insert(rng.randrange(len(lines) + 1), line)
    return "".join(lines)


def line_doubled(rng, text):
    lines = text.splitlines(keepends=True)
    lines.insert(rng.randrange(len(lines)), rng.choice(lines))
    return "".join(lines)


def end_cut_off(rng, text):
    return text[: rng.randrange(len(text))]


HOW = [
    *(number_replaced, number_replaced, word_exchanged, letter_lost, character_added),
    *(line_lost, line_moved, line_doubled, end_cut_off),
]


def as_lists(value):
    if isinstance(value, dict):
        return {key: as_lists(item) for key, item in value.items()}
    return [as_lists(item) for item in value] if isinstance(value, list | tuple) else value


@pytest.mark.parametrize("group", range(GROUPS))
def test_a_damaged_file_is_refused_or_means_what_it_says(group):
    made = 0
    for number in range(group, MUTATIONS, GROUPS):
        rng = random.Random(number)
        text = rng.choice(TEXTS)
        for _ in range(rng.choice([1, 1, 2])):
            text = rng.choice(HOW)(rng, text)
        refused = ""
        try:
            file = read_case(text, "case.toml")  # any error but a report fails the test
            if made < 1:  # making the particles takes a while
                made += 1
                file.case()
        except CaseFileError as error:
            refused = str(error)
        assert "object at 0x" not in refused
        assert all(line.startswith("case.toml") for line in refused.splitlines()), refused
        if not refused:
            assert as_lists(file.table.model_dump(exclude_unset=True)) == file.data
