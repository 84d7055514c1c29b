"""Tension: what has surface tension, edges in 2-D and facets in 3-D, and goes from one step to the next."""

from __future__ import annotations

from tipfem.mesh.relabelled import FILM
from tipfem.physics.carried import Carried
from tipfem.typing import Array


class Tension(Carried):
    """Edges or facets of a mesh that have surface tension."""

    dimension = 2  # d
    # (F + 1, F + 1) tension between each two of the F fluids, the last one for empty space, which steering may have
    # changed since the start [N/m]
    table: Array
    films: Array  # (P, 7) of each film that broke in the remeshing that made it, see `FILM`
    entered: float  # energy of what has entered the tank in the last step [J, per metre of depth in 2-D]
    # (N, d) how far the contacts that walls hold have been drawn from where they are held [m]; None for no wall that
    # holds contacts
    strain: Array | None

    @property
    def lost(self) -> float:  # type: ignore[override]
        """See `Carried.lost`: what films released [J, per metre of depth in 2-D]."""
        return float(self.films[:, FILM.index("energy")].sum())
