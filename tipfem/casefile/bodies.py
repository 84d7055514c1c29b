"""Bodies of case files."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from pydantic import Field

from tipfem.case.body import Body
from tipfem.case.case import Case
from tipfem.case.tank import Tank
from tipfem.casefile.forms import Disc, Model, MotionTable, Point, declares, quantity
from tipfem.casefile.lists import Listed, Place
from tipfem.casefile.outlines import ShapeTable, shape_content
from tipfem.casefile.pairs import Angles, by_names
from tipfem.errors import Invalid
from tipfem.geometry.plane import shapes

# The outline of a body, by the key of its table that has it.
SHAPES: dict[str, Callable[[Any], Any]] = {
    "box": lambda box: shapes.rectangle(*box),
    "disc": lambda disc: shapes.circle(disc.centre, disc.radius),
    "polygon": shapes.polygon,
    "shape": lambda shape: shape,
}


@declares(Body)
class BodyTable(Model):
    """A rigid body in a tank in 2-D: fixed, with a prescribed motion, or, with a density or a mass, floating."""

    box: list[Point] | None = quantity("lower and upper corner", "m", None, min_length=2, max_length=2)
    disc: Disc | None = Field(None, description="a circular body")
    polygon: list[Point] | None = quantity("corners (x, y) of its outline, in order", "m", None, min_length=3)
    shape: ShapeTable | None = Field(None, description="any outline, with arcs")
    motion: MotionTable | None = Field(None, description="prescribed motion")
    contact_angle: Angles = quantity("contact angle by the names of fluids, as of a wall, one number", "degrees", {})


class Bodies(Listed):
    """See `Listed`."""

    attribute = "bodies"
    kinds: ClassVar = {"bodies": Body}
    tables: ClassVar = {"bodies": (BodyTable, "rigid bodies in the tank")}

    def written(self, case: Case, tank: Tank | None) -> Sequence[Body]:
        """See `Listed.written`: as they were added to the tank."""
        return [] if tank is None else tank.bodies

    def into(self, tank: Tank, made: list[Body]) -> list[Body]:
        """See `Listed.into`."""
        for body in made:
            tank.add(body)
        return []

    def made(self, key: str, place: Place, **given: Any) -> Body:
        """See `Listed.made`; `Invalid` if there is no shape, or more than one, or no tank in 2-D."""
        if place.dimension == 3 or place.particles:
            raise Invalid((), "is given, but bodies are for tanks in 2-D only", "body")
        shown = [name for name in SHAPES if name in given]
        if len(shown) != 1:
            has = f"has {', '.join(shown)}" if shown else "has no shape"
            raise Invalid((), f"{has}; give one of {', '.join(SHAPES)}", "body")
        return Body(SHAPES[shown[0]](given.pop(shown[0])), **given)

    def check(self, made: Sequence[Body], room: bool) -> None:
        """See `Listed.check`: names."""
        for k, body in enumerate(made):
            if body.name in [other.name for other in made[:k]]:
                text = f"is {body.name!r}, the name of another body; every body needs a name of its own"
                raise Invalid(("bodies", k, "name"), text, "tank")

    def content(self, one: Body, values: Mapping[str, Any]) -> dict[str, Any]:
        """See `Listed.content`."""
        pieces = one.outline.pieces
        centres = {None if piece.centre is None else tuple(piece.centre.tolist()) for piece in pieces}
        if centres == {None}:
            place: dict[str, Any] = {"polygon": [piece.start.tolist() for piece in pieces]}
        elif len(centres) == 1:  # the radius as it was given, without the round-off of the outline
            place = {
                "disc": {"centre": np.asarray(pieces[0].centre).tolist(), "radius": float(f"{pieces[0].radius:.12g}")}
            }
        else:
            place = {"shape": {**shape_content(one.outline), "names": None}}
        angles = {"contact_angle": by_names(one.contact_angle)} if one.contact_angle else {}
        return {"name": one.name, **values, **angles, "shape": None, **place}

    def facts(self, case: Case) -> dict[str, Any]:
        """See `Listed.facts`: outlines at t = 0, and the points that poses place [m]."""
        return {
            "bodies": [
                {"name": b.name, "corners": b.corners.tolist(), "reference": b.reference.tolist()} for b in case.bodies
            ]
        }

    def steered(self, case: Case) -> dict[str, list[Any]]:
        """See `Listed.steered`: numbers of those that float, which a page drags by pokes."""
        return {"drag": [number for number, body in enumerate(case.bodies) if body.floats]}

    def record(self, one: Body, values: dict[str, Any]) -> dict[str, Any]:
        """See `Listed.record`: as polygons, which a body in a tank has."""
        return {**values, "shape": one.corners}
