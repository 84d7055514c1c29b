"""Setting: all that pictures show of a case beside its states."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from tipfem.results.fields.catalogue import Flow, drawn_fields

from .arrays import Array
from .blocks import Blocks
from .bodies import BodyOutline
from .mirror import mirrored_outline
from .openings import gaps_of, seen_of
from .scene import Scene
from .tank import TankOutline
from .volume import Volume, upwards


class Setting:
    """A case as case.json has it, and its states as scenes or volumes; see `tipfem.render.Results` for attributes."""

    def __init__(self, case: Mapping[str, Any]) -> None:
        self.title = str(case.get("title") or "")
        self.dimension = int(case["dimension"])
        self.fluid_names = tuple(str(fluid["name"]) for fluid in case["fluids"])
        self.fluid_densities = tuple(float(fluid["density"]) for fluid in case["fluids"])
        self.lower, self.upper = (np.asarray(case[key], float)[: self.dimension] for key in ("lower", "upper"))
        self._blocks, self._up = Blocks.of(case.get("blocks")), upwards(case.get("gravity", ()))
        self.spacing = float(case["spacing"])
        period = case.get("period")
        self.period = None if period is None else np.asarray(period, float)[:2]
        outline = case.get("tank")
        self.axial = case.get("coordinates") == "axisymmetric"
        outline = mirrored_outline(outline) if outline and self.axial else outline
        self._tank = None if outline is None else TankOutline(outline, self.spacing)
        self.openings = gaps_of(case.get("openings", ()))
        self._outlines = [BodyOutline(body) for body in case.get("bodies", ())]

    def names_of(self, numbers: Iterable[int]) -> list[str]:
        """Names of openings by their numbers."""
        return [self.openings[number].name for number in numbers]

    def scene_of(
        self,
        flow: Flow,
        time: float,
        wall: Array | None,
        poses: Sequence[tuple[float, ...]],
        shut: Collection[str],
        **more: Any,
    ) -> Scene:
        """A state in 2-D with bodies and the tank at poses, and the names of openings that are ``shut``."""
        return Scene(
            **{**self._shared(flow, time), "wall": wall, **more},
            bodies=tuple(body.placed(*pose) for body, pose in zip(self._outlines, poses, strict=False)),
            tank=None if self._tank is None else self._tank.placed(*poses[-1]),
            openings=seen_of(self.openings, shut, flow.position, flow.data.get("velocity")),
            period=self.period,
            axial=self.axial,
        )

    def volume_of(self, flow: Flow, time: float, wall: Array, pose: Array, **more: Any) -> Volume:
        """A state in 3-D, the tank at a pose; ``more`` attributes take the place of those of the case."""
        shared = {**self._shared(flow, time), **more}
        return Volume(**shared, wall=wall, up=self._up, blocks=self._blocks, pose=pose)

    def _shared(self, flow: Flow, time: float) -> dict[str, Any]:
        """Attributes that scenes and volumes have in common."""
        fields, cell_fields = drawn_fields(flow)
        return {
            "position": flow.position,
            "cells": flow.cells,
            "fluid": np.ravel(flow.data["fluid"]).astype(np.int64),
            "fluid_names": self.fluid_names,
            "fluid_densities": self.fluid_densities,
            "lower": self.lower,
            "upper": self.upper,
            "spacing": self.spacing,
            "cell_fluid": flow.cell_fluid,
            "fields": fields,
            "cell_fields": cell_fields,
            "time": time,
            "title": self.title,
        }
