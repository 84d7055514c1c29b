"""A flow in 3-D as one HTML file: the surface of its densest fluid at all stored times, which the reader turns."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from tipfem.render import Results, Volume
from tipfem.render.blocks import EDGES
from tipfem.render.renderer import render_frame
from tipfem.render.scales import digits_of
from tipfem.render.surface import Surface, fluid_surface
from tipfem.render.viewer.packing import fluid_looks, from_lowest, steps_of, turned, webp

from tipfem.typing import Array

POSTER = (640, 360)  # [px]
MOST = 65_535  # numbers of a place along an axis


class SolidState(NamedTuple):
    """A time of a flow in 3-D as page/solid.js reads it."""

    time: float  # [s]
    counts: tuple[int, int, int]  # of points, of faces, and of faces along walls
    edges: list[float]  # ends of the edges of the tank, and of each block in it, x, y and z of each [m]
    area: float  # of the faces off the walls [m^2]
    data: bytes  # see `packed_surface`


def solid_state(volume: Volume, lower: Array, upper: Array) -> SolidState:
    """The surface of the fluid of a volume that is drawn, between two corners (3,) [m]."""
    surface = fluid_surface(volume, volume.drawn)
    counts = len(surface.points), len(surface.faces), int(surface.flat.sum())
    of_blocks = volume.blocks_now[:, EDGES].reshape(-1, 2, 3)
    edges = [float(f"{value:.5g}") for value in np.concatenate([volume.room.edges, of_blocks]).ravel()]
    a, b, c = np.moveaxis(surface.points[surface.faces[~surface.flat]], 1, 0)
    area = float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)
    return SolidState(volume.time, counts, edges, area, packed_surface(surface, lower, upper))


def surface_page(results: Results, rate: float) -> tuple[dict[str, Any], str, bytes]:
    """Facts, picture and bytes of a page, see `told_of_surfaces`, of results in 3-D."""
    states = [solid_state(results.volume(k), results.lower, results.upper) for k in range(len(results))]
    title = results.title or results.folder.resolve().name
    return told_of_surfaces(results.volume(liveliest(states)), states, title, rate)


def liveliest(states: Sequence[SolidState]) -> int:
    """Number of the state with the largest surface off the walls, with which a page opens."""
    return int(np.argmax([state.area for state in states]))


def told_of_surfaces(
    one: Volume, states: Sequence[SolidState], title: str, rate: float
) -> tuple[dict[str, Any], str, bytes]:
    """Facts of a page of states that are played at a rate [1/s], its picture, and bytes that page/solid.js reads."""
    coded = base64.b64encode(webp(render_frame(one, POSTER), 70)).decode()
    edges = [state.edges for state in states]
    facts = {
        "title": title,
        **space_of(one),
        "times": [float(f"{state.time:.7g}") for state in states],
        "digits": max(3, digits_of([state.time for state in states])),
        "best": liveliest(states),
        "rate": rate,
        "counts": [state.counts for state in states],
        "edges": edges if any(edge != edges[0] for edge in edges) else edges[:1],
    }
    picture = f'<img alt="The flow" src="data:image/webp;base64,{coded}">'
    return facts, picture, b"".join(state.data for state in states)


def space_of(volume: Volume) -> dict[str, Any]:
    """Facts that page/solid.js needs of the tank and of the fluid that is shown."""
    looks = fluid_looks(volume.fluid_names, volume.fluid_densities)
    space = {
        "lower": volume.lower.tolist(),
        "upper": volume.upper.tolist(),
        "up": volume.up,
        "blocks": len(volume.blocks_now),
    }
    return {**space, "fluids": [looks[volume.drawn]]}


def packed_surface(surface: Surface, lower: Array, upper: Array) -> bytes:
    """A surface as bytes: places of its points as numbers of 16 bits between two corners (3,) [m], faces of 32 bits.

    Faces along walls stand first. All are told by differences, see `turned`.
    """
    places = np.clip(np.rint((surface.points - lower) / (upper - lower) * MOST), 0, MOST).astype(np.int64)
    faces = from_lowest(surface.faces)
    faces = faces[np.lexsort((faces[:, 0], ~surface.flat))]
    return b"".join([turned(np.diff(places, axis=0, prepend=0).T, "<i4"), turned(steps_of(faces), "<i4")])
