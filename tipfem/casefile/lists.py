"""Lists of tables in case files: declarations of the objects that they become, for all that reads or writes them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, NamedTuple, TypeVar

from pydantic import Field, create_model

from tipfem.case.case import Case
from tipfem.case.tank import Tank
from tipfem.casefile.forms import Model

M = TypeVar("M", bound=Model)


class Place(NamedTuple):
    """Tank and particles that tables are about, as far as these have no mistakes."""

    dimension: int | None
    tank: bool  # whether there is a table for one
    particles: bool  # whether there is one for these, in its place
    shape: bool  # whether the tank is a shape of the plane
    sides: list[str] | None  # names of the tank's walls


class Listed:
    """Objects of a `Case`, in lists of tables of its case file; `tipfem.casefile.registry` has one of each kind."""

    attribute: ClassVar[str]  # name in the arguments of `Case`, and in the record of a case
    kinds: ClassVar[Mapping[str, type[Any]]]  # their classes by the keys of their lists
    tables: ClassVar[Mapping[str, tuple[type[Model], str]]]  # what they are read from, and its words, by these keys
    key: ClassVar[str] = ""  # of other tables that name one of them; "" for none
    title: ClassVar[str] = ""  # before the lines of `tipfem check` on them
    forms: ClassVar[tuple[type[Model], ...]] = ()  # of their values, beside those that others have, too
    named: ClassVar[bool] = False  # whether their tables are by names, in place of a list
    words: ClassVar[Mapping[str, str]] = {}  # that users try as keys, and what there is to say of them

    def of(self, case: Case) -> Sequence[Any]:
        """Objects of a case, as they were given."""
        return tuple(getattr(case, self.attribute))

    def written(self, case: Case, tank: Tank | None) -> Sequence[Any]:
        """Objects that its case file has, beside a ``tank`` if that is written."""
        return self.of(case)

    def into(self, tank: Tank, made: list[Any]) -> list[Any]:
        """Put them into a tank; those that `Case` is given."""
        return made

    def name(self, key: str, table: Any) -> str:
        """Name of the one that a table in the list of a key becomes."""
        return str(table.name)

    def made(self, key: str, place: Place, **given: Any) -> Any:
        """One of them, of the keys of its table; None where nothing can be said of it."""
        return self.kinds[key](**given)

    def check(self, made: Sequence[Any], room: bool) -> None:
        """Check all of a case together, which may have ``room``: a free surface; else `Invalid`."""

    def content(self, one: Any, values: Mapping[str, Any]) -> dict[str, Any]:
        """The keys of its table, of its ``values`` that differ from the default."""
        return dict(values)

    def record(self, one: Any, values: dict[str, Any]) -> dict[str, Any]:
        """Record of one, for checkpoints, of its plain ``values``."""
        return values

    def restored(self, record: Mapping[str, Any]) -> Any:
        """The one that a record describes."""
        return next(iter(self.kinds.values()))(**record)

    def facts(self, case: Case) -> dict[str, Any]:
        """Facts of those of a case that pictures need, for case.json."""
        return {}

    def steered(self, case: Case) -> dict[str, list[Any]]:
        """List by the names of commands to a run what they act on, as JSON."""
        return {}

    def lines(self, case: Case) -> list[str]:
        """A line for people on each of a case."""
        return []

    def hints(self, case: Case) -> list[str]:
        """Lines on likely mistakes."""
        return []


def with_lists(found: Sequence[Listed]) -> Callable[[type[M]], type[M]]:
    """Add the lists to the table of a whole case file."""
    fields: dict[str, Any] = {}
    for each in found:
        for key, (table, text) in each.tables.items():
            kind: Any = dict[str, table] if each.named else list[table]
            fields[key] = kind, Field({} if each.named else [], description=text)

    def extended(table: type[M]) -> type[M]:
        return create_model(table.__name__, __base__=table, __doc__=table.__doc__, __module__=__name__, **fields)

    return extended
