"""Shapes in case files: outlines of corners and arcs, or circles, with holes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from tipfem.casefile.forms import Disc, Model, Point, quantity
from tipfem.geometry.plane.drawings import read_drawing
from tipfem.geometry.plane.shapes import Piece, Shape, arc, circle, polygon


class ArcTable(Model):
    """An edge that is an arc."""

    edge: int = quantity("number of the edge, from 0; edge k runs from corner k to the next", ge=0)
    centre: Point = quantity("centre of the arc, as far from both corners", "m")
    clockwise: bool = quantity("whether it runs clockwise", default=False)


class OutlineTable(Model):
    """An outline: corners in order, joined by straight edges or arcs; or a circle."""

    corners: list[Point] | None = quantity("corners (x, y) in order", "m", None, min_length=2)
    names: list[str] | None = quantity(
        "names of the sides, one for each edge, or one for a circle; by default side0, side1 and so on",
        default=None,
        min_length=1,
    )
    arcs: list[ArcTable] = Field([], description="the edges that are arcs")
    circle: Disc | None = Field(None, description="a circle, in place of corners")

    def outline(self, holes: list[Shape]) -> Shape:
        """The shape within the outline, less holes; `ValueError` if it is not valid."""
        if (self.corners is None) == (self.circle is None):
            raise ValueError("give either corners or a circle")
        if self.circle is not None:
            if self.arcs:
                raise ValueError("arcs are given with a circle; they are for corners only")
            names = self.names or ["side0"]
            if len(names) != 1:
                raise ValueError(f"names has {len(names)} names; a circle has one side")
            return circle(self.circle.centre, self.circle.radius, name=names[0], holes=holes)
        assert self.corners is not None
        items: list[Any] = []
        arcs = {one.edge: one for one in self.arcs}
        if wrong := [edge for edge in arcs if edge >= len(self.corners)]:
            raise ValueError(f"arcs names the edge {wrong[0]}; the last one is {len(self.corners) - 1}")
        for k, corner in enumerate(self.corners):
            items.append(corner)
            if k in arcs:
                items.append(arc(arcs[k].centre, clockwise=arcs[k].clockwise))
        return polygon(items, names=self.names, holes=holes)


class ShapeTable(OutlineTable):
    """A shape of the plane: what is within an outline, less holes; or what a drawing has."""

    holes: list[OutlineTable] = Field([], description="outlines that are cut out")
    drawing: str | None = quantity(
        "a drawing, DXF or SVG, in place of corners, its path relative to the case file: its largest closed outline, "
        "less those inside it; sides have the names of the layer of their lines, or the ids of their elements",
        default=None,
        min_length=1,
    )
    layer: list[str] | None = quantity(
        "where in the drawing the outline is, by name: on which layer of a DXF file; in which element, group or layer "
        "of SVG. By default it is all of the drawing",
        default=None,
        min_length=1,
    )
    scale: float | None = quantity(
        "by which the coordinates of the drawing are multiplied, 1e-3 for one in mm; by default a DXF file's own unit",
        "",
        None,
        gt=0,
    )
    tolerance: float | None = quantity(
        "largest distance of the drawing's splines and ellipses from chords; by default 0.001 of their size",
        "m",
        None,
        gt=0,
    )

    def shape(self, folder: Path) -> Shape:
        """The shape, with paths relative to the folder; `ValueError` if an outline, a hole or the drawing is wrong."""
        if self.drawing is not None:
            if given := [key for key in ("corners", "names", "arcs", "circle", "holes") if getattr(self, key)]:
                text = f"{given[0]} is given with a drawing, which has the outline and its names"
                raise ValueError(f"{text}; leave it out")
            return read_drawing(folder / self.drawing, self.layer, scale=self.scale, tolerance=self.tolerance)
        if given := [key for key in ("layer", "scale", "tolerance") if getattr(self, key) is not None]:
            raise ValueError(f"{given[0]} is given without a drawing, which it is about")
        holes = []
        for k, table in enumerate(self.holes):
            try:
                hole = table.outline([])
            except ValueError as error:
                raise ValueError(f"holes[{k}]: {error}") from error
            holes.append(hole if table.names else corners_of(hole))
        return self.outline(holes)


def corners_of(hole: Shape) -> Any:
    """A hole without names of its own, as `polygon` numbers its sides."""
    items: list[Any] = []
    for piece in hole.loops[0]:
        items.append(piece.start)
        if piece.centre is not None:
            items.append(arc(piece.centre.tolist(), clockwise=piece.angle < 0))
    return items


def shape_content(shape: Shape) -> dict[str, Any]:
    """A shape as the content of a `ShapeTable`."""
    first, *others = (_outline_content(loop) for loop in shape.loops)
    return {**first, "holes": others} if others else first


def _outline_content(loop: tuple[Piece, ...]) -> dict[str, Any]:
    content: dict[str, Any] = {
        "corners": [np.asarray(piece.start).tolist() for piece in loop],
        "names": [piece.name for piece in loop],
    }
    arcs = [
        {"edge": k, "centre": piece.centre.tolist(), "clockwise": piece.angle < 0}
        for k, piece in enumerate(loop)
        if piece.centre is not None
    ]
    return {**content, "arcs": arcs} if arcs else content
