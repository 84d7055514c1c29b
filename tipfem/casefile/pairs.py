"""Values of interfaces in case files, as tables of tables by the names of their two fluids."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import AfterValidator, Discriminator, Field, Tag

Pair = str | tuple[str, str]
SURFACE = "surface"


def by_pairs(table: Mapping[str, Any]) -> dict[Pair, float]:
    """Values of a table of tables by names of two fluids, or of one at a free surface, for which `SURFACE` stands."""
    found: dict[Pair, float] = {}
    for one, value in table.items():
        if value is None:  # it has mistakes
            continue
        of = value if isinstance(value, dict) else {SURFACE: value}
        found.update({one if other == SURFACE else (one, other): each for other, each in of.items()})
    return found


def by_names(pairs: Mapping[Any, float]) -> dict[str, Any]:
    """Values of interfaces as a table of tables, see `by_pairs`: by the first fluid's name, and by the second's."""
    result: dict[str, dict[str, float]] = {}
    for pair, value in pairs.items():
        one, other = (*((pair,) if isinstance(pair, str) else pair), SURFACE)[:2]
        result.setdefault(one, {})[other] = value
    return {one: of[SURFACE] if set(of) == {SURFACE} else of for one, of in result.items()}


def _by_pair(limits: Any, *, two: bool = False) -> Any:
    """A number of an interface, or a list of ``two``, by the names of two fluids or of one."""
    number: Any = Annotated[float, limits]
    kinds: dict[Any, str] = {dict: "table", list: "list" if two else "number"}
    tag = Discriminator(lambda value: kinds.get(type(value), "number"))
    each = Annotated[number, Tag("number")]
    if two:
        each |= Annotated[list[number], Field(min_length=2, max_length=2), Tag("list")]
        number = Annotated[each, tag]
    return dict[str, Annotated[each | Annotated[dict[str, number], Tag("table")], tag]]


Tensions = dict[str, Any] if TYPE_CHECKING else _by_pair(Field(ge=0))
_angles = _by_pair(Field(ge=0, le=180), two=True)
Angles = dict[Pair, Any] if TYPE_CHECKING else Annotated[_angles, AfterValidator(by_pairs)]
"""Contact angles in a table, as `tipfem.Wall` takes them."""
