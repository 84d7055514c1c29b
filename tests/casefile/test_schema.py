"""The schema agrees with the classes that its tables become, and the JSON schema with the schema."""

import dataclasses
import json
import re

import jsonschema
import pytest
from demo_runs import DEMOS
from pydantic import ValidationError
from test_bad_input import GOOD, MISTAKES

import tipfem as tp
from tipfem.app.commands import EXIT_CODES
from tipfem.case.declaration import changed, declared, made, plain, table
from tipfem.casefile import schema
from tipfem.casefile.forms import table_of
from tipfem.casefile.loading import read_case
from tipfem.casefile.problems import CaseFileError
from tipfem.casefile.schema import json_schema
from tipfem.casefile.source import tomllib
from tipfem.casefile.variables import substituted
from tipfem.probes import KINDS

DOCS = DEMOS.parent / "docs"
RULE_KEYS = ("relocation", "fitting", "surface")
RULES = [tp.Numerics, tp.FittedRule, tp.RelocationRule, tp.SurfaceRule]
TABLES = [tp.Inlet, tp.Outlet, tp.WavePiston, tp.IrregularWaves, tp.Beach]


def limits(field):
    """(attribute, value) of the limits in a field's metadata."""
    return [
        (name, getattr(item, name)) for item in field.metadata for name in ("ge", "gt", "le") if hasattr(item, name)
    ]


@pytest.mark.parametrize("kind", RULES, ids=lambda kind: kind.__name__)
def test_a_class_and_its_table_refuse_the_same(kind):
    table, count = table_of(kind), 0
    assert dataclasses.asdict(kind()) == table().model_dump()
    for name, field in table.model_fields.items():
        for limit_kind, limit in limits(field):
            beyond = limit if limit_kind == "gt" else limit - 1 if limit_kind == "ge" else limit + 1
            with pytest.raises(ValueError, match=f"{name} is"):
                kind(**{name: beyond})
            with pytest.raises(ValidationError):
                table(**{name: beyond})
            if limit_kind != "gt":
                table(**{name: limit})
            count += 1
    assert count >= 7


@pytest.mark.parametrize(
    "kind", [*RULES, *KINDS.values(), *TABLES, tp.Fluid, tp.Body, tp.Wall, tp.Motion], ids=lambda kind: kind.__name__
)
def test_every_field_is_declared_with_a_sentence(kind):
    for name, field in declared(kind).items():
        assert field.sentence, name
        assert "{" not in field.expected()


def test_a_range_is_in_words_once():
    words = {name: field.expected() for name, field in declared(tp.Numerics).items()}
    assert words["rho_inf"] == "a number from 0 to 1"
    assert words["newton_tolerance"] == "a number from 1e-14 to 0.1 in spacings"
    assert words["newton_iterations"] == "a whole number from 1 to 100"
    assert words["pressure"] == "one of 'auto', 'continuous', 'two-sided'"
    assert declared(tp.Body)["stiffness"].expected() == "a list of 3 numbers >= 0"
    assert declared(tp.Body)["centre"].expected() == "a list of 2 numbers in m"


def test_the_tables_of_the_docs_have_every_number_with_its_range():
    page = (DOCS / "howto" / "numbers.md").read_text("utf-8")
    for kind in [*RULES, *KINDS.values(), *TABLES]:
        assert f".{kind.__name__} -->" in page
    listed = (DOCS / "howto" / "case-files.md").read_text("utf-8").partition("The types are ")[2].partition(";")[0]
    assert set(re.findall(r"`([\w ]+)`", listed)) == set(KINDS)
    rows = table(tp.Numerics).splitlines()
    assert "| `rho_inf` | a number from 0 to 1 | `0.0` | spectral radius at infinity of generalized-alpha. |" in rows
    assert len(rows) == 2 + len([field for field in dataclasses.fields(tp.Numerics) if field.name not in RULE_KEYS])


def test_records_make_the_same_again():
    numerics = tp.Numerics(rho_inf=0.5, surface=tp.SurfaceRule(alpha=1.3))
    assert changed(numerics) == {"rho_inf": 0.5, "surface": {"alpha": 1.3}}
    assert made(tp.Numerics, changed(numerics)) == made(tp.Numerics, plain(numerics)) == numerics


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
    for name, content in {**json_schema()["$defs"], "Case": json_schema()}.items():
        for key, node in content["properties"].items():
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
    example, more, variables = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    file = read_case(example + more, "drop.toml", overrides=["fluids.water.viscosity=2e-3"])
    assert substituted(tomllib.loads(variables), pytest.fail)["fill"][0]["box"][1] == [0.08, 0.16]
    assert len(file.case().particles) > 500
    tp.Simulation(file.case()).step()


def test_the_mistakes_shown_in_the_docs_are_those_that_are_told():
    page = (DOCS / "howto" / "case-files.md").read_text("utf-8")
    example, *_ = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    (shown,) = re.findall(r"```text\n(.*?)```", page, re.DOTALL)
    wrong = example.replace("998.2", "-998.2", 1).replace('fluid = "water"', 'fluid = "watr"', 1)
    with pytest.raises(CaseFileError) as error:
        read_case(wrong.replace('"ramp"', '"rmp"'), "drop.toml")
    assert str(error.value).splitlines() == shown.splitlines()


def test_all_exit_codes_are_in_the_docs():
    page = (DOCS / "howto" / "case-files.md").read_text("utf-8")
    rows = re.findall(r"^\| ([\d, ]+) \|", page, re.MULTILINE)
    assert [int(code) for row in rows for code in row.split(",")] == list(EXIT_CODES)
