"""Units of the columns of a history, and which of them are of a step, so that their sums are of the run."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import NamedTuple


class Column(NamedTuple):
    """Unit and kind of a column of the history."""

    unit: str  # of its values; empty for counts and ratios. J, N and N s are per metre of depth in 2-D
    # whether it has what happened in the step, so that a sum over rows is of the run; otherwise it has the value at the
    # end of the step
    of_step: bool = False


# By patterns of their whole names, the first that fits. FLUID stands for the names of the fluids, "V" for the unit of a
# volume; "/m" is added where `per_depth` says so.
_PATTERNS: list[tuple[str, str, bool]] = [
    ("step|particles|rebuilt|impact", "", False),
    ("newton_iterations|krylov_iterations|refused_steps|relocated|broken_films", "", True),
    ("newton_residual", "spacings", False),
    ("time|wall_seconds", "s", False),
    ("time_step", "s", True),
    ("max_speed", "m/s", False),
    ("(low|high)est_pressure", "Pa", False),
    ("remeshing_(potential|surface)_energy|breakup_energy|opening_energy", "J", True),
    (r"\w*_dissipation|external_work|opening_work|energy_residual", "J", True),
    (r"(\w+_)?(kinetic|potential|surface)_energy", "J", False),
    ("(remeshing|opening)_momentum_[xyz]|momentum_residual_[xyz]", "N s", True),
    ("momentum_[xyz]", "N s", False),
    ("(wall|opening)_force_[xyz]", "N", False),
    ("(solve|source|remeshing|opening)_volume_FLUID|through_.+_FLUID|broken_film_volume", "V", True),
    ("(spray_)?volume_FLUID", "V", False),
    ("roughness_FLUID", "", False),
    ("interface_turning", "degrees", False),
]
_OF_WHAT_MOVES = {
    **{"x": "m", "y": "m", "angle": "rad", "velocity_x": "m/s", "velocity_y": "m/s", "angular_velocity": "rad/s"},
    **{"force_x": "N", "force_y": "N", "moment": "N m", "z": "m", "turn_x": "rad", "turn_y": "rad", "turn_z": "rad"},
}
_PER_DEPTH = ("J", "N", "N s", "N m")


def contents_of(dimension: int, coordinates: str = "planar") -> int:
    """3 where volumes are in m^3, in 3-D and in axisymmetric flows; 2 where all is per metre of depth."""
    return 3 if coordinates == "axisymmetric" else dimension


def per_depth(unit: str, contents: int) -> str:
    """The unit, per metre of depth where ``contents`` is 2; see `contents_of`."""
    return f"{unit}/m" if contents == 2 else unit


def require_apart(columns: Mapping[str, Iterable[str]]) -> None:
    """`ValueError` unless each column of a history has a name of its own."""
    of: dict[str, str] = {}
    for owner, names in columns.items():
        for name in names:
            if name in of:
                both = f"two of {owner}" if of[name] == owner else f"one of {of[name]} and one of {owner}"
                text = f"two columns of the history would be {name!r}, {both}; rename one of them"
                raise ValueError(f"Simulation: {text}")
            of[name] = owner


def history_columns(
    names: Iterable[str], contents: int, fluids: Iterable[str], moving: Iterable[str] = ()
) -> dict[str, Column]:
    """Columns by their names, without those of the user and of a detailed budget.

    ``contents`` is of `contents_of`, ``moving`` names what is rigid and moves, beside the tank.
    """
    fluid = f"({'|'.join(map(re.escape, fluids))})"
    found = {f"{body}_{what}": Column(unit) for body in (*moving, "tank") for what, unit in _OF_WHAT_MOVES.items()}
    patterns = [(re.compile(words.replace("FLUID", fluid)), Column(unit, of)) for words, unit, of in _PATTERNS]
    result = {}
    for name in names:
        column = found.get(name) or next((what for words, what in patterns if words.fullmatch(name)), None)
        if column is not None:
            unit = f"m{contents}" if column.unit == "V" else column.unit
            result[name] = column._replace(unit=per_depth(unit, contents) if unit in _PER_DEPTH else unit)
    return result
