"""Checks of the particles of a case: that they have fluids and places of their own, and walls around them."""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from tipfem.case.particles import Particles
from tipfem.errors import Invalid
from tipfem.geometry.period import Period
from tipfem.geometry.plane.domain import Domain
from tipfem.typing import Array

# A wall particle of a closed case farther than this inside the convex hull is an inner wall [spacings].
INNER_WALL = 0.1


def require_labels(particles: Particles, fluids: int, *, dry_walls: bool) -> None:
    """`Invalid` unless all particles have one of the fluids; with ``dry_walls``, or -1, on walls."""
    bad = (particles.fluid < np.where(particles.wall & dry_walls, -1, 0)) | (particles.fluid >= fluids)
    if bad.any():
        i = int(np.argmax(bad))
        text = f"with {fluids} fluid(s) it must lie between 0 and {fluids - 1}"
        raise _invalid(f"particle {i} has fluid {int(particles.fluid[i])}; {text}")


def require_apart(particles: Particles) -> None:
    """`Invalid` if two particles coincide, or the spacing is not theirs."""
    median = particles.require_distinct()
    if not 0.1 <= particles.spacing / median <= 10:
        text = f"spacing is {particles.spacing:g} m, but the particles stand {median:g} m apart (median)"
        raise _invalid(f"{text}; the two may differ by a factor of 10 at most")


def require_walls_at_rest(particles: Particles, *, moving: bool) -> None:
    """`Invalid` unless some particles are of fluids, and those of walls at rest, if no walls are ``moving``."""
    fast = particles.wall & (particles.velocity != 0).any(axis=1)
    if not moving and fast.any():
        i = int(np.argmax(fast))
        text = f"wall particle {i} has velocity {particles.velocity[i].tolist()} m/s"
        raise _invalid(f"{text}; walls are fixed, it must be zero")
    if particles.wall.all():
        raise _invalid("all particles are wall particles; there is no fluid to move")


def require_walls_around(particles: Particles, period: Period, domain: Domain | None, inner: Array) -> None:
    """`Invalid` unless wall particles surround all others; those of ``inner`` (N,) may be inside the convex hull.

    ``domain`` bounds the fluids; None for the convex hull of the particles.
    """
    position, wall = particles.position, particles.wall
    if period.everywhere:
        if wall.any():
            i = int(np.argmax(wall))
            text = "is a wall particle; a domain that is periodic in all directions has no walls"
            raise _invalid(f"particle {i} at {position[i].tolist()} {text}")
        return
    if domain is not None:
        domain.require_surrounds(position, wall, particles.spacing)
        return
    centred = (position - position.mean(axis=0)) / particles.spacing
    try:
        facets = ConvexHull(centred).equations
    except QhullError as error:
        text = f"{particles.dimension + 1} or more are needed, not all on one line or in one plane"
        raise _invalid(f"the {len(particles)} particles enclose no space; {text}") from error
    # Facets of one straight wall have the same equation up to round-off; one of them is enough.
    facets = facets[np.unique(facets.round(12), axis=0, return_index=True)[1]]
    depth = np.full(len(particles), np.inf)  # below the nearest facet [spacings]
    # One by one: all at once would take facets x particles of memory.
    for facet in facets[~facets[:, period.axes].any(axis=1)]:
        depth = np.minimum(depth, -(centred @ facet[:-1] + facet[-1]))
    outside = ~wall & (depth < 1e-9)
    if outside.any():
        i = int(np.argmax(outside))
        text = "lies outside the walls (or on them); wall particles must surround all others"
        raise _invalid(f"particle {i} at {position[i].tolist()} {text}")
    within = wall & (depth > INNER_WALL) & ~inner
    if within.any():
        i = int(np.argmax(within))
        text = f"wall particle {i} at {position[i].tolist()} lies {depth[i]:.2g} spacings inside the convex hull of "
        text += "all particles; "
        text += (
            "a closed case has outer walls only, unless shape=... gives what the walls enclose"
            if particles.dimension == 2
            else "in 3-D those given as arrays are the outer walls of a convex tank; see Tank.block"
        )
        raise _invalid(text)


def _invalid(text: str) -> Invalid:
    return Invalid("particles", f": {text}", "Case")
