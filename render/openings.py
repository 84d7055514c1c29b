"""Openings in the walls of a tank, to be drawn as gaps in their lines."""

import dataclasses
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .arrays import Array

ON_LINE = 1e-5  # distance from an opening of the particles on it [widths]
PASSES = 1e-3  # part of the largest speed of all from which on a mean speed is a flow through an opening
COLOURS = {"inlet": "#007a5e", "outlet": "#b34700", "vent": "#5a6675"}


@dataclass(frozen=True)
class Gap:
    """An opening."""

    kind: str  # "inlet", "outlet" or "vent"
    ends: Array  # (2, 2) of it [m]
    inwards: Array  # (2,) unit vector into the tank
    open: Array | None = None  # (K, 2) times in which its valve is open [s]; None for always
    name: str = ""  # of the opening
    enters: bool = False  # whether fluid comes in there, by its arrows

    def is_open(self, time: float) -> bool:
        """Whether it is open at a time [s]; a closed one is drawn as a wall."""
        return self.open is None or bool(((self.open[:, 0] <= time) & (time < self.open[:, 1])).any())


def gaps_of(facts: Iterable[Mapping[str, Any]]) -> tuple[Gap, ...]:
    """The openings that case.json describes, each by ``kind``, ``ends`` [m] and ``inwards``."""
    return tuple(
        Gap(
            "outlet" if one.get("drains") else str(one["kind"]),
            np.asarray(one["ends"], float),
            np.asarray(one["inwards"], float),
            np.asarray(one["open"], float) if "open" in one else None,
            str(one.get("name", "")),
            one["kind"] == "inlet" and not one.get("drains"),
        )
        for one in facts
    )


def seen_of(gaps: Iterable[Gap], shut: Collection[str], position: Array, velocity: Array | None) -> tuple[Gap, ...]:
    """The openings that are not ``shut``, by name, with arrows that follow what passes.

    Without velocities (N, 2) [m/s] of the particles openings have their usual arrows.
    """
    found = [gap for gap in gaps if gap.name not in shut]
    if velocity is None:
        return tuple(found)
    fastest = float(np.sqrt((velocity**2).sum(axis=1)).max(initial=0.0))
    for k, gap in enumerate(found):
        way = gap.ends[1] - gap.ends[0]
        width = float(np.linalg.norm(way))
        along, height = (position - gap.ends[0]) @ way / width**2, (position - gap.ends[0]) @ gap.inwards
        speed = velocity[:, :2][(along > 0) & (along < 1) & (np.abs(height) < ON_LINE * width)] @ gap.inwards
        if len(speed) and abs(float(speed.mean())) > PASSES * fastest:
            found[k] = dataclasses.replace(gap, enters=bool(speed.mean() > 0))
    return tuple(found)


def on_both_sides(gaps: Iterable[Gap]) -> tuple[Gap, ...]:
    """Openings of the half r >= 0 of an axisymmetric flow with their images; a disc is one from side to side."""
    found = []
    for gap in gaps:
        a, b = gap.ends
        image = gap.ends[::-1] * (-1.0, 1.0)
        if a[1] == b[1] and min(a[0], b[0]) == 0:
            found.append(dataclasses.replace(gap, ends=np.stack([image[0], b] if a[0] == 0 else [a, image[1]])))
        else:
            found += [gap, dataclasses.replace(gap, ends=image, inwards=gap.inwards * (-1.0, 1.0))]
    return tuple(found)


def rows_of(gaps: Iterable[Gap]) -> list[list[Any]]:
    """Openings for a page: kind, ends x, y and x, y, the direction inwards x, y, and whether fluid comes in."""
    return [[gap.kind, *gap.ends.ravel().tolist(), *gap.inwards.tolist(), gap.enters] for gap in gaps]


def kinds_of(openings: Sequence[Gap]) -> list[str]:
    """The kinds of openings that there are, for the legend."""
    return [kind for kind in COLOURS if any(gap.kind == kind for gap in openings)]
