"""Variables of a case file: numbers with names, and values that are written with them, as ``"= gate / 2"``."""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Iterator
from typing import Any

from tipfem.arguments import is_number, meant
from tipfem.casefile.source import Path

TABLE = "variables"
LONGEST = 200  # characters of a formula
_OPERATORS: dict[type[ast.AST], Callable[..., float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.UAdd: operator.pos,
    ast.USub: operator.neg,
}


def substituted(data: dict[str, Any], report: Callable[[Path, str], None]) -> dict[str, Any]:
    """A content whose formulas are numbers, in place; mistakes are reported by their paths, and left out."""
    given = data.get(TABLE, {})
    known: dict[str, float] = {}
    if isinstance(given, dict):
        for name, value in given.items():  # each may use those above it
            found = _number((TABLE, name), value, known, report)
            if not name.isidentifier():
                report((TABLE, name), "is no name for a variable; it must be letters, digits and _, as gate_width")
            elif found is not None:
                known[name] = given[name] = found
    for path, holder, key in list(_formulas(data, ())):
        if path[0] != TABLE:
            found = _number(path, holder[key], known, report)
            holder[key] = 1.0 if found is None else found
    return data


def _formulas(value: Any, path: Path) -> Iterator[tuple[Path, Any, Any]]:
    """The formulas in a content: the path of each, and the table or list that it stands in, with its key there."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, item in items:
        if isinstance(item, str) and item.startswith("="):
            yield (*path, key), value, key
        else:
            yield from _formulas(item, (*path, key))


def _number(path: Path, value: Any, known: dict[str, float], report: Callable[[Path, str], None]) -> float | None:
    """The number that a value is, or that its formula gives; None with a mistake."""
    if is_number(value):
        return value  # type: ignore[no-any-return]
    if not (isinstance(value, str) and value.startswith("=") and len(value) <= LONGEST):
        report(path, f'is {value!r}; it must be a number, or a formula of variables above it, as "= 2 * width"')
        return None
    try:
        found = _value(ast.parse(value[1:].strip(), mode="eval").body, known)
    except ZeroDivisionError:
        report(path, f"is {value!r}, which divides by zero")
    except _UnknownError as error:
        names = ", ".join(known) or "none"
        text = f"there is no variable {error.args[0]!r}, but {names}{meant(error.args[0], list(known))}"
        report(path, f"is {value!r}; {text}")
    except (SyntaxError, KeyError, ValueError, TypeError, RecursionError, MemoryError, OverflowError):
        text = f"is {value!r}, which is no formula; it takes numbers, variables, + - * / and parentheses"
        report(path, text)
    else:
        if math.isfinite(found):
            return found
        report(path, f"is {value!r}, which is {found}")
    return None


class _UnknownError(Exception):
    """A formula has a name that is no variable's."""


def _value(node: ast.expr, known: dict[str, float]) -> float:
    if isinstance(node, ast.Constant) and is_number(node.value):
        return node.value  # type: ignore[return-value]
    if isinstance(node, ast.Name):
        if node.id not in known:
            raise _UnknownError(node.id)
        return known[node.id]
    if isinstance(node, ast.BinOp):
        return _OPERATORS[type(node.op)](_value(node.left, known), _value(node.right, known))
    if isinstance(node, ast.UnaryOp):
        return _OPERATORS[type(node.op)](_value(node.operand, known))
    raise ValueError(ast.dump(node))
