"""Values of interfaces in case files, as tables of tables by the names of their two fluids."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

Pair = str | tuple[str, str]


def by_pairs(table: Mapping[str, Any]) -> dict[Pair, float]:
    """Values by the names of two fluids, or of one at a free surface, of a table of tables of the second names."""
    found: dict[Pair, float] = {}
    for one, value in table.items():
        if value is None:  # it has mistakes
            continue
        found.update({(one, other): each for other, each in value.items()} if isinstance(value, dict) else {one: value})
    return found


def by_names(pairs: Mapping[Any, float]) -> dict[str, Any]:
    """Values of interfaces as a table of tables: by the first fluid's name, and by the second's."""
    result: dict[str, Any] = {}
    for pair, value in pairs.items():
        if isinstance(pair, str):
            result[pair] = value
        else:
            result.setdefault(pair[0], {})[pair[1]] = value
    return result
