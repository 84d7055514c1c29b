"""TOML with lines: every key is found where it stands, however it is written."""

import re

import pytest
from case_texts import paths_of

from tipfem.casefile.source import SyntaxProblem, keys_of, parse, value_of

TEXT = '''#:schema somewhere
title = "A # in a text, [not] a table"   # a comment with = and [
gravity = [
    0.0,  # along x
    -9.81,
]

[fluids.water]
density = 998.2
"viscosity" = 1.0e-3
[fluids."heavy oil"]
density = 1_000
viscosity.value = 3

[[fill]]
fluid = 'air'
[[fill]]
fluid = "water"
box = [[0, 0], [1, 2]]
[fill.more]
x = { a = 1, b = { c = [1, 2] }, d = """
two
lines""" }
after = 2024-01-01

[tank]
long = """
[fake]
key = 1
"""
quoted = "escaped \\" quote = ["
last = true
'''


def test_every_path_of_the_content_has_a_line():
    source = parse(TEXT)
    assert paths_of(source.data) == set(source.lines)


def test_lines_are_those_of_the_text():
    source = parse(TEXT)
    lines = TEXT.splitlines()
    for path, start in {
        ("title",): "title",
        ("gravity", 1): "    -9.81",
        ("fluids", "water", "viscosity"): '"viscosity"',
        ("fluids", "heavy oil", "viscosity", "value"): "viscosity.value",
        ("fill", 1): "[[fill]]",
        ("fill", 1, "box", 1, 0): "box",
        ("fill", 1, "more", "x", "b", "c", 1): "x = ",
        ("fill", 1, "more", "after"): "after",
        ("tank", "last"): "last",
    }.items():
        assert lines[source.line(path) - 1].startswith(start), path
    assert source.line(("fill", 1)) > source.line(("fill", 0))


def test_what_is_missing_is_placed_at_the_table_around_it():
    source = parse(TEXT)
    assert source.line(("fluids", "water", "colour")) == source.line(("fluids", "water"))
    assert source.line(("nothing",)) == 1


def test_windows_line_ends_count_once():
    assert parse("a = 1\r\nb = 2\r\n").line(("b",)) == 2


@pytest.mark.parametrize(("text", "line"), [("a = \n", 1), ("a = 1\na = 2\n", 2), ("[x\n", 1), ('a = 1\nb = "', 2)])
def test_what_is_no_toml_says_the_line(text, line):
    with pytest.raises(SyntaxProblem) as error:
        parse(text)
    assert error.value.line == line
    assert error.value.reason


def test_keys_and_values_of_overrides():
    assert keys_of('fluids."heavy oil".density') == ["fluids", "heavy oil", "density"]
    assert value_of("2e-3") == 2e-3
    assert value_of("[1, 2]") == [1, 2]
    assert value_of("sharp") == "sharp"
    assert value_of("1\nother = 2") == "1\nother = 2"
    for wrong in ("", "a..b", "a b", "a.", "=", "."):
        with pytest.raises(ValueError, match=f"^{re.escape(wrong)}$"):
            keys_of(wrong)
