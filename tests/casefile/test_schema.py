"""The schema agrees with the classes that its tables become, and the JSON schema with the schema."""

import dataclasses
import json
import re

import jsonschema
import pytest
from demo_runs import DEMOS
from test_bad_input import GOOD, MISTAKES

import tipfem as tp
from tipfem.casefile import schema
from tipfem.casefile.commands import EXIT_CODES
from tipfem.casefile.loading import read_case
from tipfem.casefile.problems import CaseFileError
from tipfem.casefile.schema import json_schema
from tipfem.casefile.source import tomllib

DOCS = DEMOS.parent / "docs"
RULES = [
    (tp.Numerics, schema.NumericsTable),
    (tp.FittedRule, schema.FittingTable),
    (tp.RelocationRule, schema.RelocationTable),
    (tp.SurfaceRule, schema.SurfaceTable),
]


def limits(field):
    """(attribute, value) of the limits in a field's metadata."""
    return [
        (name, getattr(item, name)) for item in field.metadata for name in ("ge", "gt", "le") if hasattr(item, name)
    ]


def refusal(rule, name, value):
    """What a rule says of a value; nothing if it takes it."""
    try:
        rule(**{name: value})
    except ValueError as error:
        return str(error)
    return ""


@pytest.mark.parametrize(("rule", "table"), RULES, ids=lambda kind: kind.__name__)
def test_names_and_defaults_are_those_of_the_class(rule, table):
    defaults = dataclasses.asdict(rule())
    given = table().model_dump()
    assert defaults == given


@pytest.mark.parametrize(("rule", "table"), RULES, ids=lambda kind: kind.__name__)
def test_limits_are_those_of_the_class(rule, table):
    """At a limit the class takes the value, or refuses it beside others only; beyond it, it refuses the value."""
    count = 0
    for name, field in table.model_fields.items():
        for kind, limit in limits(field):
            if kind == "gt":
                refused = limit
            else:
                assert f"{name} is" not in refusal(rule, name, limit)
                refused = limit - 1 if kind == "ge" else limit + 1
            with pytest.raises(ValueError, match=f"{name} is"):
                rule(**{name: refused})
            count += 1
    assert count >= 7


def test_limits_of_fluids_tanks_and_grading_are_those_of_the_classes():
    for name, make in {
        "density": lambda value: tp.Fluid("a", value, 1.0),
        "viscosity": lambda value: tp.Fluid("a", 1.0, value),
    }.items():
        for kind, limit in limits(schema.FluidTable.model_fields[name]):
            if kind == "ge":
                make(limit)
            with pytest.raises(ValueError, match=name):
                make(limit if kind == "gt" else limit - 1)
    for kind, limit in limits(schema.TankTable.model_fields["jitter"]):
        tp.tank((1, 1), 0.1, jitter=limit)
        with pytest.raises(ValueError, match="jitter"):
            tp.tank((1, 1), 0.1, jitter=limit + (0.1 if kind == "le" else -0.1))
    for kind, limit in limits(schema.GradingTable.model_fields["growth"]):
        tp.Grading({}, growth=limit)
        with pytest.raises(ValueError, match="growth"):
            tp.Grading({}, growth=limit + (0.1 if kind == "le" else -0.1))


def test_every_key_is_described():
    for name, table in {**json_schema()["$defs"], "Case": json_schema()}.items():
        for key, node in table["properties"].items():
            assert node.get("description"), f"{name}.{key}"


def test_the_json_schema_takes_the_demos_and_refuses_what_the_schema_refuses():
    validator = jsonschema.Draft202012Validator(json_schema())
    for path in sorted((DEMOS / "cases").glob("*.toml")):
        text = path.read_text("utf-8")
        validator.validate(tomllib.loads(text))
        named = text.splitlines()[0].removeprefix("#:schema ")
        assert (path.parent / named).resolve() == DOCS / schema.SCHEMA_ID
    validator.validate(tomllib.loads(GOOD))
    for name in (
        "negative density",
        "misspelt viscosity",
        "four sizes",
        "form misspelt",
        "no end",
        "unknown interface",
    ):
        old, new, *_ = MISTAKES[name]
        assert not validator.is_valid(tomllib.loads(GOOD.replace(old, new, 1))), name


def test_the_json_schema_in_the_docs_is_this_one():
    assert json.loads((DOCS / "case.schema.json").read_text("utf-8")) == json_schema()


def test_the_annotated_example_of_the_docs_is_a_case(tmp_path):
    page = (DOCS / "howto" / "case-files.md").read_text("utf-8")
    example, more = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    file = read_case(example + more, "drop.toml", overrides=["fluids.water.viscosity=2e-3"])
    assert len(file.case().particles) > 500
    file.simulation().step()


def test_the_mistakes_shown_in_the_docs_are_those_that_are_told():
    page = (DOCS / "howto" / "case-files.md").read_text("utf-8")
    example, _ = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    (shown,) = re.findall(r"```text\n(.*?)```", page, re.DOTALL)
    wrong = example.replace("998.2", "-998.2", 1).replace('fluid = "water"', 'fluid = "watr"', 1)
    with pytest.raises(CaseFileError) as error:
        read_case(wrong.replace('"ramp"', '"rmp"'), "drop.toml")
    assert str(error.value).splitlines() == shown.splitlines()


def test_all_exit_codes_are_in_the_docs():
    page = (DOCS / "howto" / "case-files.md").read_text("utf-8")
    rows = re.findall(r"^\| ([\d, ]+) \|", page, re.MULTILINE)
    assert [int(code) for row in rows for code in row.split(",")] == list(EXIT_CODES)
