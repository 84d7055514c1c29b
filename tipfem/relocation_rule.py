"""The rule of relocation: when a particle is moved, and where to."""

from __future__ import annotations

from dataclasses import dataclass

from tipfem.validation import is_number


@dataclass(frozen=True)
class RelocationRule:
    """When a particle is moved, and where to. All lengths in target spacings h.

    Attributes:
        too_close: a particle closer than this to another is moved.
        too_close_to_wall: a particle closer than this to a face of the wall is moved.
        long_edge: edges within a fluid longer than this take a particle at their middle.
        long_mixed_edge: edges between two fluids longer than this take a particle at a third of
            their length, so that no gap opens between the fluids.
        urgent: a particle closer than this to another is moved into any edge longer than h.
        at_surface: factor on these distances where one of two particles is on a free surface, and
        along_surface: where both are, and for heights of particles on the surface over a wall.

    Raises:
        ValueError: a length is not positive, or a rule would undo itself.
    """

    too_close: float = 0.6
    too_close_to_wall: float = 0.4
    long_edge: float = 1.2
    long_mixed_edge: float = 1.8
    urgent: float = 0.35
    at_surface: float = 0.75
    along_surface: float = 0.5

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (is_number(value) and value > 0):
                raise ValueError(f"RelocationRule: {name} is {value!r}; it must be > 0 (in spacings)")
        if self.long_edge < 2 * self.too_close - 1e-12:
            raise ValueError(
                f"RelocationRule: long_edge {self.long_edge:g} is below twice too_close {self.too_close:g}; "
                "a particle set into such an edge would be moved again at once"
            )
        if self.long_mixed_edge < 3 * self.too_close - 1e-12:
            raise ValueError(
                f"RelocationRule: long_mixed_edge {self.long_mixed_edge:g} is below three times too_close "
                f"{self.too_close:g}; a particle set at a third of such an edge would be moved again at once"
            )
