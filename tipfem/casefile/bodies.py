"""Bodies of case files: from their tables to `tipfem.Body`, and back."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from tipfem.case.body import Body
from tipfem.case.declaration import changed
from tipfem.case.walls import Motion
from tipfem.casefile.pairs import by_names, by_pairs
from tipfem.casefile.schema import BODY, BodyTable
from tipfem.casefile.source import Path
from tipfem.geometry.plane import shapes

Given = Callable[..., dict[str, Any] | None]
SHAPES = ("box", "disc", "polygon")


def read_bodies(
    tables: Sequence[BodyTable | None], given: Given, made: Callable[..., Any], report: Callable[[Path, str], None]
) -> list[Body]:
    """The bodies that tables describe, None for those with mistakes; mistakes are reported with their paths.

    ``given`` has the values of a table at a path, with functions of time checked; None where they have mistakes.
    ``made`` is what a function makes of further arguments, or None, and a report at a path.
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
            report((*path, "name"), f"is {table.name!r}, the name of another body; every body needs a name of its own")
            continue
        options = {key: value for key, value in table.given().items() if key in BODY}
        if table.contact_angle:
            options["contact_angle"] = by_pairs(table.contact_angle)
        if table.motion is not None:
            motion = given((*path, "motion"), table.motion, translation=2)
            if motion is None:
                continue  # its mistake has been reported
            if not {"translation", "angle"} & set(motion):
                report((*path, "motion"), "has neither translation nor angle; give one, or leave the table out")
                continue
            options["motion"] = made((*path, "motion"), Motion, **motion)
            if options["motion"] is None:
                continue
        body = made(path, lambda table=table, options=options: Body(_shape(table), **options))
        if body is not None:
            found.append(body)
    return found


def _shape(table: BodyTable) -> shapes.Shape:
    if table.box is not None:
        return shapes.rectangle(*table.box)
    if table.disc is not None:
        return shapes.circle(table.disc.centre, table.disc.radius)
    return shapes.polygon(table.polygon or [])


def body_content(
    body: Body, kept: Callable[[str, Any], dict[str, Any]], lost: Callable[[str, str], str]
) -> dict[str, Any]:
    """The table of a body; values that have their defaults are left out.

    ``kept`` makes a table of a dataclass, which has a name for messages; ``lost`` a value of the file for a part that
    it cannot keep, for a reason.
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
        content["motion"] = kept(f"bodies.{body.name}.motion", body.motion)
    if body.contact_angle:
        content["contact_angle"] = by_names(body.contact_angle)
    given = changed(body)
    return {**content, **{key: given[key] for key in BODY if key in given}}
