"""Lists of tables in case files: declarations of the objects that they become, for all that reads or writes them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, TypeVar

from pydantic import Field, create_model

from tipfem.case.case import Case
from tipfem.casefile.forms import Model

M = TypeVar("M", bound=Model)


class Listed:
    """Objects of a `Case`, in lists of tables of its case file; `tipfem.casefile.registry` has one of each kind."""

    attribute: ClassVar[str]  # name in the arguments of `Case`, and in the record of a case
    kinds: ClassVar[Mapping[str, type[Any]]]  # their classes by the keys of their lists
    tables: ClassVar[Mapping[str, tuple[type[Model], str]]]  # what they are read from, and its words, by these keys
    key: ClassVar[str] = ""  # of other tables that name one of them; "" for none
    title: ClassVar[str] = ""  # before the lines of `tipfem check` on them
    forms: ClassVar[tuple[type[Model], ...]] = ()  # of their values, beside those that others have, too
    in_tank: ClassVar[bool] = False  # whether they are added to a tank in 2-D, in place of being given to `Case`
    words: ClassVar[Mapping[str, str]] = {}  # that users try as keys, and what there is to say of them

    def of(self, case: Case) -> Sequence[Any]:
        """Objects of a case, as they were given."""
        return tuple(getattr(case, self.attribute))

    def written(self, case: Case) -> Sequence[Any]:
        """Objects that its case file has."""
        return self.of(case)

    def name(self, key: str, table: Any) -> str:
        """Name of the one that a table in the list of a key becomes."""
        return str(table.name)

    def made(self, key: str, **given: Any) -> Any:
        """One of them, of the keys of its table."""
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

    def lines(self, case: Case) -> list[str]:
        """A line for people on each of a case."""
        return []

    def hints(self, case: Case) -> list[str]:
        """Lines on likely mistakes."""
        return []


def with_lists(found: Sequence[Listed]) -> Callable[[type[M]], type[M]]:
    """Add the lists to the table of a whole case file."""
    fields: dict[str, Any] = {
        key: (list[table], Field([], description=text)) for each in found for key, (table, text) in each.tables.items()
    }

    def extended(table: type[M]) -> type[M]:
        return create_model(table.__name__, __base__=table, __doc__=table.__doc__, __module__=__name__, **fields)

    return extended
