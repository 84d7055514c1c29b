"""The probes of a case file."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

from tipfem.casefile.problems import listed, meant
from tipfem.casefile.schema import ProbeTable
from tipfem.casefile.source import Path
from tipfem.probes import KINDS, Probe

KIND_NAMES = {kind.__name__ for kind in KINDS.values()}


def read_probes(
    tables: Sequence[ProbeTable | None], fluids: Sequence[str], report: Callable[[Path, str], None]
) -> list[Probe]:
    """The probes of checked tables, as far as they can be checked without particles.

    Args:
        tables: of the probes; those with mistakes are None.
        fluids: names of the fluids.
        report: takes the path of a mistake and what is wrong.
    """
    probes = []
    seen: list[str] = []
    for k, table in enumerate(tables):
        if table is None:
            continue
        path: Path = ("probes", k)
        kind = KINDS[table.type]
        fields = {field.name: field for field in dataclasses.fields(kind)}
        given = {key: value for key in type(table).model_fields if (value := getattr(table, key)) is not None}
        wrong = [key for key in given if key != "type" and key not in fields]
        for key in wrong:
            report((*path, key), f"is no key of the probe type {table.type!r}; its keys are {', '.join(fields)}")
        missing = [name for name, field in fields.items() if field.default is dataclasses.MISSING and name not in given]
        for key in missing:
            report((*path, key), f"is missing; a probe of type {table.type!r} needs it")
        if "fluid" in given and "fluid" in fields and table.fluid not in fluids:
            hint = meant(table.fluid or "", fluids)
            report((*path, "fluid"), f"is {table.fluid!r}; it must be one of the fluids {listed(fluids)}{hint}")
        elif not wrong and not missing:
            values = {key: value for key, value in given.items() if key != "type"}
            try:
                probes.append(kind(**values))
            except ValueError as error:
                text = str(error).partition(": ")[2]
                key = text.partition(" ")[0]
                report((*path, key) if key in fields else path, text.removeprefix(f"{key} ") if key in fields else text)
        if table.name in seen:
            report((*path, "name"), f"is {table.name!r}, the name of an earlier probe; give another")
        seen.append(table.name)
    return probes
