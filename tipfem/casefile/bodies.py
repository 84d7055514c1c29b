"""Bodies of case files: from their tables to `tipfem.Body`, and back."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from tipfem.case.body import Body
from tipfem.case.declaration import changed
from tipfem.case.walls import Motion
from tipfem.casefile.schema import BODY, BodyTable
from tipfem.casefile.source import Path
from tipfem.geometry import shapes

Function = Callable[[Path, Any, int], Any]
Place = Callable[[ValueError, Path], tuple[Path, str]]
SHAPES = ("box", "disc", "polygon")


def read_bodies(
    tables: Sequence[BodyTable | None], function: Function, report: Callable[[Path, str], None], place: Place
) -> list[Body]:
    """The bodies that tables describe; their mistakes are reported.

    Args:
        tables: of the case file, None for those that have mistakes.
        function: checks a function of time at a path, whose values have a number of coordinates.
        report: takes the path of a mistake and what is wrong.
        place: gives both of an error and the path of the table around it.
    """
    found: list[Body] = []
    for k, table in enumerate(tables):
        if table is None:
            continue
        path: Path = ("bodies", k)
        shown = [key for key in SHAPES if getattr(table, key) is not None]
        if len(shown) != 1:
            has = f"has {', '.join(shown)}" if shown else "has no shape"
            report(path, f"{has}; give one of {', '.join(SHAPES)}")
            continue
        if table.name in [body.name for body in found]:
            report((*path, "name"), f"is {table.name!r} as that of another body; every body needs a name of its own")
            continue
        try:
            given = {
                key: function((*path, "motion", key), getattr(table.motion, key), n)
                for key, n in {"translation": 2, "angle": 0}.items()
                if table.motion is not None
            }
            if any(value is None and getattr(table.motion, key) is not None for key, value in given.items()):
                continue  # its mistake has been reported
            motion = None
            if table.motion is not None:
                if not any(given.values()):
                    report((*path, "motion"), "has neither translation nor angle; give one, or leave the table out")
                    continue
                motion = Motion(given["translation"], given["angle"], table.motion.pivot)
            found.append(Body(_shape(table), motion=motion, **{k: v for k, v in table.given().items() if k in BODY}))
        except ValueError as error:
            report(*place(error, path))
    return found


def _shape(table: BodyTable) -> shapes.Shape:
    if table.box is not None:
        return shapes.rectangle(*table.box)
    if table.disc is not None:
        return shapes.circle(table.disc.centre, table.disc.radius)
    return shapes.polygon(table.polygon or [])


def body_content(body: Body, function: Callable[[str, Any], Any], lost: Callable[[str, str], str]) -> dict[str, Any]:
    """The table of a body; values that have their defaults are left out.

    Args:
        body: the body.
        function: makes a value of the file of a function of time, which has a name for messages.
        lost: makes a value of the file for a part that it cannot keep, for a reason.
    """
    pieces = body.outline.pieces
    content: dict[str, Any] = {"name": body.name}
    if all(piece.centre is None for piece in pieces):
        content["polygon"] = [piece.start.tolist() for piece in pieces]
    elif len({None if piece.centre is None else tuple(piece.centre.tolist()) for piece in pieces}) == 1:
        centre = np.asarray(pieces[0].centre)
        # The radius as it was given, without the round-off of the outline.
        content["disc"] = {"centre": centre.tolist(), "radius": float(f"{pieces[0].radius:.12g}")}
    else:
        content["polygon"] = lost(f"bodies.{body.name}.shape", "an outline with straight edges and arcs")
    if body.motion is not None:
        motion = body.motion
        given = {key: getattr(motion, key) for key in ("translation", "angle")}
        content["motion"] = {key: function(f"bodies.{body.name}.motion.{key}", f) for key, f in given.items() if f}
        if motion.pivot is not None:
            content["motion"]["pivot"] = np.asarray(motion.pivot, dtype=float).tolist()
    kept = changed(body)
    return {**content, **{key: kept[key] for key in BODY if key in kept}}
