"""Openings in the walls of a tank, to be drawn as gaps in their lines."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .arrays import Array

COLOURS = {"inlet": "#007a5e", "outlet": "#b34700", "vent": "#5a6675"}


@dataclass(frozen=True)
class Gap:
    """An opening.

    Attributes:
        kind: "inlet", "outlet" or "vent".
        ends: (2, 2) of it [m].
        inwards: (2,) unit vector into the tank.
        open: (K, 2) times in which its valve is open [s]; None for always.
    """

    kind: str
    ends: Array
    inwards: Array
    open: Array | None = None

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
        )
        for one in facts
    )


def kinds_of(openings: Sequence[Gap]) -> list[str]:
    """The kinds of openings that there are, for the legend."""
    return [kind for kind in COLOURS if any(gap.kind == kind for gap in openings)]
