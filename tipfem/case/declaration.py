"""Values that a user gives, declared once: type, range and unit stand at the field, the sentence in the docstring.

    too_close: Annotated[float, Ge(0.1), Le(0.95), Unit("spacings")] = 0.6

From this follow what `require` refuses, the tables and the JSON schema of case files (`tipfem.casefile.forms`),
what they and checkpoints keep (`plain`, `changed`, `made`), and the tables of the documentation.
"""

from __future__ import annotations

import collections.abc
import dataclasses
import operator
import re
import types
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from inspect import cleandoc
from numbers import Real
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
from annotated_types import Ge, Gt, Le, Len, MinLen

from tipfem.arguments import brief, is_number, numbers
from tipfem.errors import Invalid

T = TypeVar("T")
FUNCTION: Any = collections.abc.Callable
SCALARS = {
    float: "a number",
    int: "a whole number",
    bool: "True or False",
    str: "a non-empty string",
    FUNCTION: "a function of time",
    Sequence: "a list of numbers",
    Any: "a value",
}
PLURALS = {float: "numbers", int: "whole numbers", str: "texts", Sequence: "lists of numbers"}


@dataclass(frozen=True)
class Unit:
    """The unit of a value, in its annotation."""

    name: str

    def __get_pydantic_json_schema__(self, core: Any, handler: Callable[[Any], dict[str, Any]]) -> dict[str, Any]:
        return {**handler(core), "unit": self.name}


@dataclass(frozen=True)
class Declared:
    """A field of a dataclass as it is declared."""

    annotation: Any  # its type with range and unit, as pydantic takes it
    # float, int, bool, str, Literal, a dataclass, for lists Sequence, for functions alone Callable, or a tuple of
    # classes; other types are not checked
    kind: Any
    items: Any  # of lists, the type of an item
    choices: tuple[Any, ...]  # of Literal, also beside another kind
    optional: bool  # whether it may be None
    function: bool  # whether it may be a function
    limits: tuple[Any, ...]  # Ge, Gt, Le; Len or MinLen of lists
    unit: str  # empty for none
    sentence: str  # of the docstring
    default: Any  # or `dataclasses.MISSING`

    def expected(self) -> str:
        """The values that it takes, in words."""
        if isinstance(self.kind, tuple) and float in self.kind:
            others = " or ".join(
                f"a{cleandoc(kind.__doc__ or '').partition('.')[0][1:]}" for kind in self.kind if kind is not float
            )
            return f"{replace(self, kind=float).expected()}, or {others}"
        bounds = " and ".join(
            f"{sign} {getattr(limit, name):g}"
            for limit in self.limits
            for name, sign in (("ge", ">="), ("gt", ">"), ("le", "<="))
            if hasattr(limit, name)
        )
        if bounds.startswith(">= ") and " and <= " in bounds:
            bounds = "from " + bounds[3:].replace(" and <= ", " to ")
        if self.kind is Literal:
            words = f"one of {', '.join(map(repr, self.choices))}"
        elif self.kind is Sequence:
            few, most = self._length()
            count = f"{few} " if few == most else f"{few} or {most} " if most else f"at least {few} "
            words = f"a list of {count}{PLURALS.get(get_origin(self.items) or self.items, 'items')}"
        else:
            kinds = self.kind if isinstance(self.kind, tuple) else (self.kind,)
            words = " or ".join(SCALARS.get(kind) or f"a {kind.__name__}" for kind in kinds)
            words = "a text" if self.kind is str and self.default == "" else words
        unit = self.unit and f"{'to a value ' * (self.kind is FUNCTION)}in {self.unit}"
        words = " ".join(filter(None, [words, bounds, unit]))
        words += "".join(f", or {choice!r}" for choice in self.choices if self.kind is not Literal)
        return f"{words}, or a function" if self.function and self.kind is not FUNCTION else words

    def takes(self, value: Any) -> bool:
        """Whether a value is of the type and in the range."""
        if value is None:
            return self.optional
        if (self.function and callable(value)) or (isinstance(value, str) and value in self.choices):
            return True
        if isinstance(self.kind, tuple):
            return any(replace(self, kind=kind).takes(value) for kind in self.kind)
        if self.kind is float:
            return is_number(value) and self._in_range(value)
        if self.kind is int:
            return is_number(value) and value == int(value) and self._in_range(value)
        if self.kind is Literal:
            return False
        if self.kind is str:
            return isinstance(value, str) and (bool(value) or value == self.default)
        if self.kind is Sequence and self.items is float:
            array, (few, most) = numbers(value), self._length()
            fits = array.ndim == 1 and few <= len(array) <= (most or len(array)) and bool(np.isfinite(array).all())
            return fits and all(map(self._in_range, array))
        checked = self.kind not in (Any, Sequence) and isinstance(self.kind, type | tuple)
        return isinstance(value, self.kind) if checked else True

    def _in_range(self, value: Any) -> bool:
        return all(
            compare(value, getattr(limit, name))
            for limit in self.limits
            for name, compare in (("ge", operator.ge), ("gt", operator.gt), ("le", operator.le))
            if hasattr(limit, name)
        )

    def _length(self) -> tuple[int, int | None]:
        given = next((limit for limit in self.limits if isinstance(limit, Len | MinLen)), MinLen(1))
        return given.min_length, getattr(given, "max_length", None)


def declared(kind: type) -> Mapping[str, Declared]:
    """The fields of a dataclass that its constructor takes, by their names."""
    if kind in _FOUND:
        return _FOUND[kind]
    hints, sentences = get_type_hints(kind, include_extras=True), sentences_of(kind)
    found = {}
    for field in dataclasses.fields(kind):
        if not field.init:
            continue
        default = field.default
        if field.default_factory is not dataclasses.MISSING:
            default = field.default_factory()
        found[field.name] = _declared(hints[field.name], sentences.get(field.name, ""), default)
    _FOUND[kind] = found
    return found


_FOUND: dict[type, Mapping[str, Declared]] = {}


def _declared(annotation: Any, sentence: str, default: Any) -> Declared:
    inner, limits, optional, function, choices = annotation, [], False, False, ()
    while True:
        origin, arguments = get_origin(inner), get_args(inner)
        if hasattr(inner, "__metadata__"):
            limits += inner.__metadata__
            inner = arguments[0]
        elif origin in (Union, types.UnionType):
            optional |= type(None) in arguments
            kinds = [one for one in arguments if one is not type(None)]
            others = [one for one in kinds if get_origin(one) is not FUNCTION]
            function |= len(others) < len(kinds)
            words = [one for one in others if get_origin(one) is Literal]
            if len(others) > 1:
                choices = tuple(word for one in words for word in get_args(one))
                others = [one for one in others if one not in words]
            inner = (
                FUNCTION
                if not others
                else others[0]
                if len(others) == 1
                else tuple(get_origin(one) or one for one in others)
            )
        else:
            break
    origin = Sequence if origin is tuple else origin
    items = arguments[0] if origin is Sequence else None
    if items is not None and hasattr(items, "__metadata__"):
        limits += items.__metadata__
        items = get_args(items)[0]
    unit = next((item.name for item in limits if isinstance(item, Unit)), "")
    known = tuple(item for item in limits if isinstance(item, Ge | Gt | Le | Len | MinLen))
    choices = arguments if origin is Literal else choices
    return Declared(annotation, origin or inner, items, choices, optional, function, known, unit, sentence, default)


def sentences_of(kind: type) -> dict[str, str]:
    """The sentences on the attributes of a class, of its docstring and those of the classes that it is made from."""
    found: dict[str, str] = {}
    for each in reversed(kind.__mro__):
        section = re.search(r"^Attributes:\n((?:    .*\n|\n)*)", cleandoc(each.__doc__ or "") + "\n", re.MULTILINE)
        for names, text in re.findall(
            r"^    (\w[\w, ]*): ((?:.|\n {8})*)", section[1] if section else "", re.MULTILINE
        ):
            found.update(dict.fromkeys(names.split(", "), " ".join(text.split()).replace("``", "`")))
    return found


def table(kind: type) -> str:
    """The fields of a dataclass, but dataclasses, as a table in Markdown: name, values, default, sentence."""
    rows = ["| name | values | default | |", "|---|---|---|---|"]
    for name, field in declared(kind).items():
        if not dataclasses.is_dataclass(field.kind):
            default = "" if field.default in (dataclasses.MISSING, None) else f"`{field.default!r}`"
            rows.append(f"| `{name}` | {field.expected()} | {default} | " + field.sentence.replace("|", "\\|") + " |")
    return "\n".join(rows)


def require(
    instance: Any, path: Sequence[str | int] = (), subject: str = "", names: Sequence[str] | None = None
) -> None:
    """Check the values of a dataclass, by default all, against their declarations; else `Invalid`.

    For errors, ``path`` is the keys that lead to it, ``subject`` what it is in words of Python, by default its class.
    """
    fields = declared(type(instance))
    for name in fields if names is None else names:
        field, value = fields[name], getattr(instance, name)
        if not field.takes(value):
            number = isinstance(value, Real | Sequence) and not isinstance(value, bool | str)
            shown = f"{brief(value)} {field.unit}" if field.unit and number else brief(value)
            expected = field.expected()
            if isinstance(value, str) and field.kind in (float, int):
                shown, expected = f"{shown}, a text", f"{expected}, without quotes"
            expected += ", or left out" if field.optional else ""
            raise Invalid((*path, name), f"is {shown}; it must be {expected}", subject or type(instance).__name__)


def plain(value: Any, function: Callable[[Any], Any] = lambda value: value) -> Any:
    """A value as nested dicts and lists of plain values: dataclasses by what their constructors take."""
    if callable(value):
        return function(value)
    if dataclasses.is_dataclass(value):
        fields = [field.name for field in dataclasses.fields(value) if field.init]
        return {name: plain(getattr(value, name), function) for name in fields}
    if isinstance(value, Mapping):
        return {key: plain(item, function) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item, function) for item in value]
    return value


def changed(instance: Any) -> dict[str, Any]:
    """Values of a dataclass that differ from the default, as `plain` has them; dataclasses in it in the same way."""
    found: dict[str, Any] = {}
    for name, field in declared(type(instance)).items():
        value = getattr(instance, name)
        if dataclasses.is_dataclass(value) and isinstance(value, type(field.default)):
            value = changed(value)
            found.update({name: value} if value else {})
        elif field.default is dataclasses.MISSING or not _same(plain(value), plain(field.default)):
            found[name] = plain(value)
    return found


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        return other is not None and one is not None and np.array_equal(one, other)
    return bool(one == other)


def made(kind: type[T], record: Mapping[str, Any]) -> T:
    """The dataclass that a record of `plain` or `changed` describes; its `ValueError` passes through."""
    fields = declared(kind)
    values = {
        name: made(fields[name].kind, value)
        if isinstance(value, Mapping) and name in fields and dataclasses.is_dataclass(fields[name].kind)
        else value
        for name, value in record.items()
    }
    return kind(**values)
