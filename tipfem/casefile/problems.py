"""Mistakes in a case file, all of them in one report: where each is, what stands there and what would be right."""

from __future__ import annotations

import datetime
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from tipfem.arguments import closest, is_number, meant
from tipfem.casefile.cannot import cannot, remark
from tipfem.casefile.registry import LISTED
from tipfem.casefile.source import BARE, Path

TAGS = ("form", "type", "law")  # keys by which tables of several forms are told apart
# Keys of what tipfem has at another place.
ELSEWHERE = {
    "yield_stress non_newtonian power_law consistency rheology bingham law": "a law is the viscosity of a fluid, as "
    "viscosity = { law = 'bingham', yield_stress = 60, viscosity = 1 }",
    "axisymmetric axisymmetry cylindrical axial": "a flow around an axis has [tank] coordinates = 'axisymmetric'",
    "les smagorinsky": "an eddy viscosity is a law, viscosity = { law = 'smagorinsky', viscosity = 1e-3 }",
    "dxf svg drawing": "a drawing is a shape, of the tank or of a fill: shape = { drawing = 'pond.dxf' }",
    "mesh mesh_file": "a mesh of Gmsh is the tank: [tank] mesh = 'pond.msh', with scale = 1e-3 for one in mm",
    "baffle baffles plate": "a baffle is a notch in the tank's outline (tank.shape), a plate off the walls a thin body",
    "wave waves wave_maker piston": "waves are the motion of a wall, as walls.left.motion = { form = 'waves', height = "
    "0.03, period = 1.0, depth = 0.2 }",
    "step time_step timestep dt delta_t max_dt": "the longest step is time.largest_step",
    "from to": "the two ends of an opening or a wall are between = [[x, y], [x, y]]",
    "file_format output_format format": "how states are written is output.fields, 'vtu', 'vtkhdf' or 'both'",
    "sigma surface_tension tension": "surface tension is of two fluids; it is in the table surface_tension, as "
    "water.air = 0.0728",
    **{words: text for each in LISTED for words, text in each.words.items()},
}
NUMBER = re.compile(r"\s*[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?(?![\d.,:/-])")  # at the beginning of a text
SLIPS = ("slip", "free-slip", "free slip", "freeslip")  # no laws, though they sound so
LONGEST = 60  # characters of a value that are shown


@dataclass(frozen=True)
class Problem:
    """One mistake."""

    where: str  # file and line, or the override that it stands in
    path: Path  # of the key; empty for the whole file
    text: str  # what is wrong, as a predicate of the key ("is ...; it must be ..."), or ": " and a sentence
    line: int = 0  # in the file; 0 outside of it

    def __str__(self) -> str:
        if not self.path:
            return f"{self.where}: {self.text.removeprefix(': ')}"
        joint = "" if self.text.startswith(": ") else " "
        return f"{self.where}: {dotted(self.path)}{joint}{self.text}"


class CaseFileError(ValueError):
    """A case file with mistakes.

    Attributes:
        problems: all of them, in the order of the file.
    """

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems = tuple(sorted(problems, key=lambda problem: problem.line))
        super().__init__("\n".join(map(str, self.problems)))


def dotted(path: Path) -> str:
    """A path as it is written: ``fill[1].box``; list items are counted from 0."""
    text = ""
    for key in path:
        if isinstance(key, int):
            text += f"[{key}]"
        else:
            text += ("." if text else "") + (key if BARE.fullmatch(key) else f'"{key}"')
    return text


def shown(value: Any) -> str:
    """A value as TOML writes it, shortened if it is long."""
    if isinstance(value, Mapping):
        return "a table"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, list) and value and isinstance(value[0], Mapping):
        return "a list of tables"
    if isinstance(value, (datetime.date, datetime.time)):
        return value.isoformat()
    text = "[" + ", ".join(map(shown, value)) + "]" if isinstance(value, list) else repr(value)
    return text if len(text) <= LONGEST else text[: LONGEST - 4] + " ..." + ("]" if text.startswith("[") else "")


def listed(words: Iterable[str]) -> str:
    """Words in quotes, with commas."""
    return ", ".join(map(repr, words))


class SchemaReader:
    """Finds in a JSON schema what a key may hold."""

    def __init__(self, schema: Mapping[str, Any]) -> None:
        self.schema = schema

    def node(self, path: Path, data: Any) -> tuple[dict[str, Any], str]:
        """The schema of a path's key in the content ``data``, and its unit; empty where the schema has none."""
        node, unit = dict(self.schema), ""
        for key in path:
            node = self._chosen(node, data)
            if isinstance(key, int):
                node = dict(node.get("items", {}))
            elif key in node.get("properties", {}):
                node = dict(node["properties"][key])
            else:
                more = node.get("additionalProperties")
                node = dict(more) if isinstance(more, Mapping) else {}
            unit = node.get("unit", "" if node.get("type") == "integer" else unit)
            data = _child(data, key)
        return self._resolved(node), unit

    def keys(self, path: Path, data: Any) -> list[str]:
        """The keys that the table at a path may have."""
        node, _ = self.node(path, data)
        return list(self._chosen(node, child_at(data, path)).get("properties", {}))

    def tables_with(self, key: str) -> list[str]:
        """Tables of the top level, and tables in them, that have a key of this name."""
        found = []
        for name, node in self.schema["properties"].items():
            table = self._resolved(node)
            inner = table.get("items") or table.get("additionalProperties")
            if isinstance(inner, Mapping):
                table, name = self._resolved(inner), f"{name}[...]" if "items" in table else f"{name}.NAME"
            choices = [self._resolved(choice) for choice in table.get("oneOf", ())] or [table]
            if any(key in choice.get("properties", {}) for choice in choices):
                found.append(name)
            parts = {part: self._resolved(node) for part, node in table.get("properties", {}).items()}
            found += [f"{name}.{part}" for part, node in parts.items() if key in node.get("properties", {})]
        return found

    def expected(self, node: Mapping[str, Any], unit: str = "") -> str:
        """Description of the values that are allowed."""
        node = self._resolved(node)
        choices = node.get("oneOf") or node.get("anyOf")
        if choices:
            forms = [form for choice in choices for form in self._forms(choice)[1]]
            words = [self.expected(choice, unit) for choice in choices if not self._forms(choice)[1]]
            if forms:
                tag = self._forms(choices[-1])[0]
                words.append(f"a table with {tag} = " + " or ".join(map(repr, forms)))
            return " or ".join(words)
        if "enum" in node:
            return "one of " + listed(node["enum"])
        if "const" in node:
            return repr(node["const"])
        kind = node.get("type")
        if kind in ("number", "integer"):
            noun = "a number" if kind == "number" else "a whole number"
            return " ".join(filter(None, [noun, _range(node), f"in {unit}" if unit else ""]))
        if kind == "string":
            return "a text in quotes, not empty" if node.get("minLength") else "a text in quotes"
        if kind == "boolean":
            return "true or false"
        if kind == "array":
            return f"a list of {_count(node)}{self._plural(node.get('items', {}), unit)}"
        return "a table"

    def _plural(self, items: Mapping[str, Any], unit: str) -> str:
        node = self._resolved(items)
        if node.get("type") == "array":
            return f"lists of {_count(node)}{self._plural(node.get('items', {}), unit)}"
        if "enum" in node:
            return "of " + listed(node["enum"])
        noun = {"number": "numbers", "integer": "whole numbers", "string": "texts"}.get(node.get("type", ""), "")
        if not noun:
            return "tables" if "properties" in node or "oneOf" in node else "values"
        return " ".join(filter(None, [noun, _range(node), f"in {unit}" if unit else ""]))

    def _forms(self, node: Mapping[str, Any]) -> tuple[str, list[str]]:
        """The key by which the forms of a table are told apart, and its values in a node; none elsewhere."""
        node = self._resolved(node)
        properties, required = node.get("properties", {}), node.get("required", ())
        tag = next((tag for tag in TAGS if tag in properties and tag in required), "")
        form = properties.get(tag, {})
        return tag, list(form.get("enum", [form["const"]] if "const" in form else []))

    def tag(self, path: Path, data: Any) -> str:
        """The key by which the table at a path is told from others; empty if there are no others."""
        return self.tag_of(self._chosen(self.node(path, data)[0], child_at(data, path)))

    def tag_of(self, node: Mapping[str, Any]) -> str:
        """The key by which a table is told from others; empty for none."""
        return self._forms(node)[0]

    def forms(self, node: Mapping[str, Any]) -> list[str]:
        """The forms that a table may have."""
        return [form for choice in node.get("oneOf", ()) for form in self._forms(choice)[1]]

    def _resolved(self, node: Mapping[str, Any]) -> dict[str, Any]:
        result = dict(node)
        while "$ref" in result:
            name = result.pop("$ref").split("/")[-1]
            result = {**self.schema["$defs"][name], **result}
        return result

    def _chosen(self, node: Mapping[str, Any], value: Any) -> dict[str, Any]:
        """A node with the choice made that the value has: by its form, or by being a list or a table of any names."""
        resolved = self._resolved(node)
        for choice in resolved.get("oneOf") or resolved.get("anyOf") or ():
            is_list = self._resolved(choice).get("type") == "array"
            tag, forms = self._forms(choice)
            is_map = isinstance(self._resolved(choice).get("additionalProperties"), Mapping)
            named = (is_map and isinstance(value, Mapping)) or _child(value, tag) in forms
            if isinstance(value, list) if is_list else named:
                return self._resolved(choice)
        return resolved


class Translator:
    """Puts pydantic's errors into the words of this module."""

    def __init__(self, schema: Mapping[str, Any], data: Mapping[str, Any]) -> None:
        self.reader, self.data = SchemaReader(schema), data

    def problems(self, errors: Iterable[Mapping[str, Any]]) -> dict[Path, str]:
        """The text of each mistake by its path; those within a short list are one mistake of the list."""
        found: dict[Path, str] = {}
        for error in errors:
            path = self._path(error)
            if error["type"] == "extra_forbidden":
                found[path] = self._unknown(path)
            elif error["type"] == "missing":
                found[path] = self._missing(path)
            elif error["type"] == "union_tag_not_found" and isinstance(child_at(self.data, path), Mapping):
                path = (*path, self._tag(path))
                found[path] = self._missing(path)
            else:
                if error["type"] == "union_tag_invalid":
                    path = (*path, self._tag(path))
                path = self._whole_list(path)
                found.setdefault(path, self._wrong(path))
        for path in [path for path, text in found.items() if text.startswith(("is no key of ", "is not a known key"))]:
            # A key that is missing because it is misspelt is one mistake.
            missing = {key: (*path[:-1], key) for key in self.reader.keys(path[:-1], self.data)}
            lacking = [key for key, place in missing.items() if found.get(place, "").startswith("is missing")]
            for key in closest(str(path[-1]), lacking)[:1]:
                found.pop(missing[key])
        return found

    def _tag(self, path: Path) -> str:
        node, _ = self.reader.node(path, self.data)
        return next(filter(None, map(self.reader.tag_of, node.get("oneOf") or ())), TAGS[0])

    def _path(self, error: Mapping[str, Any]) -> Path:
        """The path in the content: pydantic's has names of forms in between."""
        path: Path = ()
        value: Any = self.data
        for place, key in enumerate(error["loc"], 1):
            last = place == len(error["loc"])
            inside = key in value if isinstance(value, Mapping) else isinstance(value, list) and isinstance(key, int)
            if inside or (last and error["type"] == "missing"):
                path = (*path, key)
                value = _child(value, key)
        return path

    def _whole_list(self, path: Path) -> Path:
        """The path of the list of numbers around an item, if it is short enough to be shown."""
        whole = path
        while whole and isinstance(whole[-1], int):
            around = child_at(self.data, whole[:-1])
            if any(isinstance(item, Mapping) for item in around) or len(repr(around)) > LONGEST:
                break
            whole = whole[:-1]
        return whole

    def _unknown(self, path: Path) -> str:
        name = str(path[-1])
        keys, table = self.reader.keys(path[:-1], self.data), child_at(self.data, path[:-1])
        if why := cannot(name):
            return why
        if place := remark(ELSEWHERE, name):
            return f"is not a known key; {place}"
        tag = self.reader.tag(path[:-1], self.data)
        tag = tag if tag in table else ""
        wrong = f"is no key of the {tag} {table[tag]!r}" if tag else "is not a known key"
        if near := closest(name, keys):
            return f"{wrong}; did you mean {' or '.join(map(repr, near))}?"
        if (table := "_".join(map(str, path))) in self.reader.keys((), self.data):
            return f"{wrong}; it is the table [{table}]"
        if not tag and (tables := self.reader.tables_with(name)):
            return f"{wrong}; there is one in {' and '.join(tables)}"
        return f"{wrong}; {'its keys' if tag else 'the keys here'} are {', '.join(keys)}"

    def _missing(self, path: Path) -> str:
        node, unit = self.reader.node(path, self.data)
        if path[-1] in TAGS and "const" not in node and "enum" not in node:
            node, unit = self.reader.node(path[:-1], self.data)
            return f"is missing; give {self.reader.expected(node, unit)}"
        described = node.get("description", "").removesuffix(f" [{unit}]")
        return f"is missing; give {self.reader.expected(node, unit)}" + (f": {described}" if described else "")

    def _wrong(self, path: Path) -> str:
        node, unit = self.reader.node(path, self.data)
        value = child_at(self.data, path)
        if path and path[-1] in TAGS and (choices := self.reader.forms(self.reader.node(path[:-1], self.data)[0])):
            hint = meant(value, choices) if isinstance(value, str) else ""
            return f"is {shown(value)}; it must be one of {listed(choices)}{hint}"
        hint = meant(value, node["enum"]) if "enum" in node and isinstance(value, str) else self._hint(path, node)
        if path[-1:] == ("law",) and value in SLIPS:
            hint = "; for a wall without friction say slip = true"
        number = isinstance(value, (int, float, list)) and not isinstance(value, bool)
        given = f"{shown(value)} {unit}" if unit and number else shown(value)
        return f"is {given}; it must be {self.reader.expected(node, unit)}{hint}"

    def _hint(self, path: Path, node: Mapping[str, Any]) -> str:
        """Hint for a text given for a number, a list for a list of lists, and a table for a list of tables."""
        value = child_at(self.data, path)
        kinds = [self.reader.node(path, self.data)[0], *(node.get("oneOf") or node.get("anyOf") or ())]
        if isinstance(value, str) and any(kind.get("type") in ("number", "integer") for kind in kinds):
            number, unit = NUMBER.match(value), self.reader.node(path, self.data)[1]
            if not number:
                return ""
            other = value[number.end() :].strip()
            same = not (other and unit) or re.sub(r"\W", "", other) == re.sub(r"\W", "", unit)
            how = f", as {number[0].strip()}" if same else f": give {value} in {unit}"
            return f"; numbers have no quotes and no unit{how}"
        if path == ("gravity",) and is_number(value):
            return f"; did you mean [0, {shown(-abs(value))}]?"
        if isinstance(value, Mapping) and len(path) == 1 and node.get("type") == "array":
            return f"; begin each with [[{path[0]}]]"
        if node.get("type") == "object" and (about := node.get("description")):
            return f": {about}"
        if isinstance(value, list) and (inner := node.get("items", {})).get("type") == "array":
            for width in range(inner.get("minItems", 2), inner.get("maxItems", 3) + 1):
                rows = [value[k : k + width] for k in range(0, len(value), width)]
                least, most = node.get("minItems", 1), node.get("maxItems", len(rows))
                if not len(value) % width and least <= len(rows) <= most and all(map(is_number, value)):
                    return f"; did you mean {shown(rows)}?"
        return ""


def _child(value: Any, key: str | int) -> Any:
    """An item of a table or list; None where there is none."""
    if isinstance(value, Mapping):
        return value.get(key)
    if isinstance(value, list) and isinstance(key, int) and -len(value) <= key < len(value):
        return value[key]
    return None


def child_at(data: Any, path: Path) -> Any:
    """Value at a path of a content; None where there is none."""
    for key in path:
        data = _child(data, key)
    return data


def _range(node: Mapping[str, Any]) -> str:
    low, high = node.get("minimum"), node.get("maximum")
    if low is not None and high is not None:
        return f"from {low:g} to {high:g}"
    words = [
        f"{sign} {node[key]:g}"
        for key, sign in (("exclusiveMinimum", ">"), ("minimum", ">="), ("exclusiveMaximum", "<"), ("maximum", "<="))
        if key in node
    ]
    return " and ".join(words)


def _count(node: Mapping[str, Any]) -> str:
    low, high = node.get("minItems"), node.get("maxItems")
    if low is None and high is None:
        return ""
    if low == high:
        return f"{low} "
    return (
        f"{low} or {high} " if high == (low or 0) + 1 else f"at least {low} " if high is None else f"{low} to {high} "
    )
