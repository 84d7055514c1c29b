"""A flow in 3-D as one HTML file: the surface of its densest fluid at all stored times, which the reader turns."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
from tipfem.render import Results, Volume
from tipfem.render.renderer import render_frame
from tipfem.render.scales import digits_of
from tipfem.render.solid import room_of
from tipfem.render.surface import Surface, fluid_surface
from tipfem.render.viewer.packing import fluid_looks, from_lowest, steps_of, turned, webp

from tipfem.typing import Array

POSTER = (640, 360)  # [px]
MOST = 65_535  # numbers of a place along an axis


def surface_page(results: Results, rate: float) -> tuple[dict[str, Any], str, bytes]:
    """Facts of a page, its picture for readers without scripts, and bytes that page/solid.js reads.

    States of a flow in 3-D are played at a rate [1/s]; `ValueError` if it is of more than two fluids.
    """
    first = results.volume(0)
    shown = int(np.argmax(first.fluid_densities))
    middle = render_frame(results.volume(len(results) // 2), POSTER)
    coded = base64.b64encode(webp(middle, 70)).decode()
    data, counts, edges = bytearray(), [], []
    for number in range(len(results)):
        volume = results.volume(number)
        surface = fluid_surface(volume, shown)
        data += packed_surface(surface, results.lower, results.upper)
        counts.append([len(surface.points), len(surface.faces), int(surface.flat.sum())])
        edges.append(_edges(volume))
    facts = {
        "title": results.title or results.folder.resolve().name,
        "lower": results.lower.tolist(),
        "upper": results.upper.tolist(),
        "up": first.up,
        "times": [float(f"{time:.7g}") for time in results.times],
        "digits": max(3, digits_of(results.times)),
        "best": len(results) // 2,
        "rate": rate,
        "fluids": [fluid_looks(results.fluid_names, results.fluid_densities)[shown]],
        "counts": counts,
        "edges": edges if any(edge != edges[0] for edge in edges) else edges[:1],
    }
    return facts, f'<img alt="The flow" src="data:image/webp;base64,{coded}">', bytes(data)


def packed_surface(surface: Surface, lower: Array, upper: Array) -> bytes:
    """A surface as bytes: places of its points as numbers of 16 bits between two corners (3,) [m], faces of 32 bits.

    Faces along walls stand first. All are told by differences, see `turned`.
    """
    places = np.clip(np.rint((surface.points - lower) / (upper - lower) * MOST), 0, MOST).astype(np.int64)
    faces = from_lowest(surface.faces)
    faces = faces[np.lexsort((faces[:, 0], ~surface.flat))]
    return b"".join([turned(np.diff(places, axis=0, prepend=0).T, "<i4"), turned(steps_of(faces), "<i4")])


def _edges(volume: Volume) -> list[float]:
    """Ends of the tank's edges, x, y and z of each [m]."""
    return [float(f"{value:.5g}") for value in room_of(volume).edges.ravel()]
