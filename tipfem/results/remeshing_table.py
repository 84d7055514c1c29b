"""Table of the energy and momentum that each kind of repair of the mesh has added in a run, fluid by fluid."""

from __future__ import annotations

import re
from collections.abc import Mapping

# Columns of `tipfem.remesh.repair_account.RepairAccount`.
COLUMN = re.compile(r"remeshing_([a-z]+)_(kinetic_energy|potential_energy|momentum_[xyz])_(.+)")
_TITLES = {"kinetic_energy": "kinetic [J]", "potential_energy": "potential [J]"}

Sums = dict[str, dict[str, dict[str, float]]]


def remeshing_sums(columns: Mapping[str, float]) -> Sums:
    """Sums [J; N s] for each kind of repair, by fluid, kind and quantity; empty without a detailed budget."""
    result: Sums = {}
    for name, value in columns.items():
        match = COLUMN.fullmatch(name)
        if match:
            kind, quantity, fluid = match.groups()
            result.setdefault(fluid, {}).setdefault(kind, {})[quantity] = float(value)
    return result


def remeshing_table(sums: Sums) -> str:
    """The `remeshing_sums` as a text in columns, the totals of each fluid last."""
    lines = []
    for fluid, kinds in sums.items():
        quantities = list(next(iter(kinds.values())))
        titles = [_TITLES.get(q) or f"{q.replace('_', ' ')} [N s]" for q in quantities]
        total = {q: sum(values[q] for values in kinds.values()) for q in quantities}
        lines.append(f"{f'remeshing, {fluid}':<24}" + "".join(f"{title:>18}" for title in titles))
        for kind, values in {**kinds, "total": total}.items():
            lines.append(f"  {kind:<22}" + "".join(f"{values[q]:>18.4g}" for q in quantities))
    return "\n".join(lines)
