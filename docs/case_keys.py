"""Every key of a case file, from its schema, with an example of each from the cases of the repository."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[1]
SCHEMA = json.loads((ROOT / "docs" / "case.schema.json").read_text("utf-8"))
CASES = [*sorted((ROOT / "tipfem/app/new").glob("*.toml")), *sorted((ROOT / "demos/cases").glob("*.toml"))]
Schema = dict[str, Any]


def resolved(schema: Schema) -> tuple[str, Schema]:
    """Name of the definition that a schema refers to, or "", and the schema itself."""
    name = schema.get("$ref", "").rpartition("/")[2]
    return name, SCHEMA["$defs"][name] if name else schema


def choices(schema: Schema) -> list[Schema]:
    """The forms that a value may have."""
    return schema.get("oneOf") or schema.get("anyOf") or [schema]


def inner(schema: Schema) -> Iterator[tuple[str, str]]:
    """Definitions within a value, each with the way to it: "" itself, "[]" in a list, ".NAME" by names."""
    for form in choices(schema):
        if "$ref" in form:
            yield resolved(form)[0], ""
        elif isinstance(form.get("items"), dict):
            yield from ((name, "[]" + way) for name, way in inner(form["items"]))
        elif isinstance(form.get("additionalProperties"), dict):
            yield from ((name, ".NAME" + way) for name, way in inner(form["additionalProperties"]))


def tables() -> dict[str, list[str]]:
    """The definitions that a case file reaches, in the order of the file, with the places of each."""
    found: dict[str, list[str]] = {}
    left = [("", "")]
    while left:
        name, place = left.pop(0)
        definition = SCHEMA["$defs"][name] if name else SCHEMA
        for key, value in definition.get("properties", {}).items():
            for name_within, way in inner(value):
                # A definition is followed from the first place that has it.
                where = f"{place}.{key}{way}".lstrip(".")
                if name_within not in found:
                    left.append((name_within, where))
                found.setdefault(name_within, []).append(where)
    return found


def title(name: str) -> str:
    """The name of a definition on the page."""
    return {"Table": "Table of times"}.get(name, name.removesuffix("Table"))


def kind(schema: Schema) -> str:
    """The values of a key in words."""
    names = []
    for form in choices(schema):
        name = resolved(form)[0]
        if name:
            names.append(f"[{title(name)}](#{name.lower()})")
        elif "const" in form:
            names.append(f"`{json.dumps(form['const'])}`")
        elif "enum" in form:
            names += [f"`{json.dumps(value)}`" for value in form["enum"]]
        elif form.get("type") == "array":
            items = form.get("items")
            names.append("list of " + kind(items) if isinstance(items, dict) and items else "list")
        elif form.get("type") == "object":
            held = form.get("additionalProperties")
            names.append("table of " + kind(held) if isinstance(held, dict) else "table")
        elif form.get("type") in ("number", "integer"):
            whole = "whole number" if form["type"] == "integer" else "number"
            bounds = [f"{sign} {form[name]:g}" for name, sign in BOUNDS.items() if name in form]
            names.append(" ".join([whole, ", ".join(bounds)]).strip())
        else:
            names.append({"string": "text", "boolean": "`true`, `false`"}.get(form.get("type", ""), "any"))
    return ", ".join(dict.fromkeys(names))


BOUNDS = {"exclusiveMinimum": ">", "minimum": ">=", "exclusiveMaximum": "<", "maximum": "<="}


def toml(value: Any) -> str:
    """A value as it is written in a case file."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {toml(each)}" for key, each in value.items()) + " }" if value else "{}"
    if isinstance(value, list):
        return "[" + ", ".join(toml(each) for each in value) + "]"
    return json.dumps(value, ensure_ascii=False)


def fits(schema: Schema, value: Any) -> bool:
    """Whether a table may be of this definition: it has no unknown and all required keys, and constants agree."""
    properties = schema.get("properties", {})
    return (
        isinstance(value, dict)
        and set(schema.get("required", ())) <= set(value) <= set(properties)
        and all(properties[key].get("const", each) == each for key, each in value.items())
    )


def examples() -> dict[tuple[str, str], str]:
    """The shortest value of each key of each definition in the cases of the repository."""
    found: dict[tuple[str, str], str] = {}

    def walk(name: str, schema: Schema, value: Any) -> None:
        for key, each in value.items():
            within = schema["properties"].get(key)
            if within is None:
                continue
            text = toml(each)
            if '"=' not in text and len(text) < min(60, len(found.get((name, key), "x" * 60))):
                found[name, key] = text
            descend(within, each)

    def descend(schema: Schema, value: Any) -> None:
        for form in choices(schema):
            name, target = resolved(form)
            if name and fits(target, value):
                walk(name, target, value)
            elif isinstance(value, list) and isinstance(form.get("items"), dict):
                for each in value:
                    descend(form["items"], each)
            elif isinstance(value, dict) and isinstance(form.get("additionalProperties"), dict):
                for each in value.values():
                    descend(form["additionalProperties"], each)

    for path in CASES:
        walk("", SCHEMA, tomllib.loads(path.read_text("utf-8")))
    return found


def made(schema: Schema) -> Any:
    """A value that a schema allows: its default, its first choice, or the least that fits."""
    forms = [resolved(form)[1] for form in choices(schema)]
    target = next(
        (form for form in forms if form.get("type") != "string" or "enum" in form or "const" in form), forms[0]
    )
    for key in ("const", "default"):
        if target.get(key) is not None:
            return target[key]
    if "enum" in target:
        return target["enum"][0]
    kinds = target.get("type")
    if kinds == "object" or "properties" in target:
        needed = target.get("required", ())
        held = target.get("additionalProperties")
        if isinstance(held, dict):
            return {"water": made(held)}
        return {key: made(target["properties"][key]) for key in needed}
    if kinds == "array":
        items = target.get("items")
        return [made(items) if isinstance(items, dict) else 0.1] * max(1, target.get("minItems", 1))
    if kinds == "boolean":
        return True
    if kinds in ("number", "integer"):
        low, high = target.get("minimum", target.get("exclusiveMinimum")), target.get("maximum")
        value = 1 if low is None or low < 1 else low
        if high is not None and value > high:
            value = high
        return int(value) if kinds == "integer" else float(value)
    return "water"


def escaped(text: str) -> str:
    """Text for a cell of a table in Markdown."""
    return text.replace("|", "\\|").replace("\n", " ")


def rows(name: str, schema: Schema, known: dict[tuple[str, str], str]) -> list[str]:
    """The keys of one table."""
    lines = ["| key | values | unit | default | example | |", "|---|---|---|---|---|---|"]
    required = schema.get("required", ())
    for key, value in schema.get("properties", {}).items():
        if not name and any(inner(value)):
            continue  # tables have sections of their own
        default = (
            "required" if key in required else f"`{toml(value['default'])}`" if value.get("default") is not None else ""
        )
        example = known.get((name, key)) or toml(made(value))
        text = value.get("description", "")
        cells = [f"`{key}`", kind(value), value.get("unit", ""), default, f"`{example}`", text]
        lines.append("| " + " | ".join(escaped(cell) for cell in cells) + " |")
    return lines


def page() -> str:
    """All tables of a case file."""
    known = examples()
    lines = ["## The file itself", "", *rows("", SCHEMA, known)]
    for name, places in tables().items():
        schema = SCHEMA["$defs"][name]
        if "properties" not in schema:
            continue
        lines += ["", f"## {title(name)} {{ #{name.lower()} }}", ""]
        where = ", ".join(f"`{place}`" for place in places[:4]) + (", ..." if len(places) > 4 else "")
        text = schema.get("description", "").split("\n\n")[0].replace("\n", " ")
        lines += [f"In {where}. {text}".strip(), "", *rows(name, schema, known)]
    return "\n".join(lines)
