"""Openings of case files: their kinds and names, and all that is read and written of them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from tipfem.arguments import is_number
from tipfem.case.case import Case
from tipfem.case.fluid import typical_viscosity
from tipfem.case.openings import LIQUID, PROFILES, Inlet, Opening, Outlet, Vent, check_balance, default_name
from tipfem.casefile.forms import Model, Point, Uniform, declares, or_function, quantity
from tipfem.casefile.lists import Listed, Place
from tipfem.errors import Invalid
from tipfem.geometry.plane.domain import Domain
from tipfem.typing import Array


class Stratified(Model):
    """Fluids of an inlet of several, from the lower or left end on."""

    form: Literal["stratified"] = Field(description="the kind of function")
    fluids: list[str] = quantity("names of the fluids, from the lower or left end on", min_length=2)
    bounds: list[float] = quantity("where each ends and the next one begins, ascending", "m", min_length=1)
    axis: Literal["x", "y"] = quantity("the coordinate of the bounds", default="y")

    def __call__(self, position: Array, time: float) -> Array:
        """Names (K,) of the fluids that enter at positions (K, 2) [m]."""
        place = np.searchsorted(self.bounds, position[:, "xy".index(self.axis)], side="right")
        return np.asarray(np.array(self.fluids)[place])


class Profile(Model):
    """Speeds across an inlet: straight lines between points."""

    form: Literal["polyline"] = Field(description="the kind of function")
    points: list[Point] = quantity(
        "points (s, v): distance from the lower or left end [m], ascending, and the speed there, which discharge or "
        "velocity scales, and which is in m/s where neither is given",
        min_length=2,
    )

    def __call__(self, s: Array, time: float) -> Array:
        """Speeds (K,) at distances (K,) [m]."""
        points = np.array(self.points)
        return np.asarray(np.interp(s, points[:, 0], points[:, 1]))


class PumpCurve(Model):
    """Head of a pump over its discharge: straight lines between points."""

    form: Literal["polyline"] = Field(description="the kind of function")
    points: list[Point] = quantity("points (q, H): discharge [m^2/s], ascending, and head [m]", min_length=2)

    def __call__(self, discharge: float) -> float:
        """Head [m] at a discharge [m^2/s]."""
        points = np.array(self.points)
        return float(np.interp(discharge, points[:, 0], points[:, 1]))


FluidOrStrata = Any if TYPE_CHECKING else or_function(str, str, {"stratified": Stratified})
"""The name of a fluid, or several by their place."""

PressureOrFunction = Any if TYPE_CHECKING else or_function(float | Literal["hydrostatic"], (int, float, str))
"""A pressure, or a function of time to one."""

HeadOrCurve = Any if TYPE_CHECKING else or_function(float, (int, float), {"polyline": PumpCurve})
"""The head of a pump, or its curve."""

ProfileOrPoints = Any if TYPE_CHECKING else or_function(PROFILES, str, {"polyline": Profile})
"""The name of a profile, or the points of one."""


@declares(Inlet)
class InletTable(Model):
    """Opening where a fluid enters, normal to the wall; in 2-D, with the sharp interface."""

    fluid: FluidOrStrata = quantity("name of the fluid that enters, or several by their place")
    profile: ProfileOrPoints = quantity(
        'how the speed varies over the part r of the width: "plug", not at all; "parabola", as r (1 - r); "power", of '
        "a turbulent flow over a bottom at the lower end, r to the power of 1/7; or by points. Where a no-slip wall "
        "ends at it the speed is zero",
        default="plug",
    )
    head: HeadOrCurve | None = quantity(
        "by which a pump raises the total head from an outlet to here, of its fluid; or a curve over the discharge",
        "m",
        None,
    )


@declares(Outlet)
class OutletTable(Model):
    """Opening where fluids leave, and enter if they are drawn in, at a given pressure or level."""

    pressure: PressureOrFunction | None = quantity(
        'on the opening, a number or a function of time; "hydrostatic": the weight of what stands in the opening below '
        "its upper end, for flows that are slower than their waves",
        "Pa",
        None,
    )


@declares(Opening)
class VentTable(Model):
    """An outlet of pressure 0, by which a gas can leave a tank that is filled."""


class Openings(Listed):
    """See `Listed`."""

    attribute = "openings"
    kinds: ClassVar = {f"{kind.kind}s": kind for kind in (Inlet, Outlet, Vent)}
    tables: ClassVar = {
        "inlets": (InletTable, "where fluids enter the tank"),
        "outlets": (OutletTable, "where fluids leave the tank"),
        "vents": (VentTable, "outlets of pressure 0, for gas"),
    }
    key = title = "opening"
    forms = (Stratified, Profile, PumpCurve)
    words: ClassVar = {
        "inlet inflow": "what flows in is in tables [[inlets]], each with wall = 'left', say, fluid and discharge",
        "outlet outflow": "where fluids leave is in tables [[outlets]], each with wall = 'right', say",
        "vent": "where gas leaves is in tables [[vents]], each with wall = 'top', say",
        "open_boundary open_boundaries opening openings boundary boundaries boundary_conditions bc": "openings are in "
        "tables [[inlets]], [[outlets]] and [[vents]]; all that is not open is a wall",
        "pump pumps fan fans": "a pump is an inlet, [[inlets]], whose key pump names the opening that draws off",
        "flow_rate flowrate volume_flow flow flux": "what enters by an inlet is its discharge, in m^2/s, or its "
        "velocity",
    }

    def name(self, key: str, table: Any) -> str:
        """See `Listed.name`: by default that of its kind and its wall."""
        return table.name or default_name(self.kinds[key].kind, table.wall)

    def made(self, key: str, place: Place, **given: Any) -> Any:
        """See `Listed.made`; `Invalid` if points of a profile, or bounds, are wrong."""
        fluid, pressure = given.get("fluid"), given.get("pressure")
        for name in ("profile", "head"):
            curve = given.get(name)
            if isinstance(curve, Profile | PumpCurve) and not (np.diff(np.array(curve.points)[:, 0]) > 0).all():
                text = f"is {curve.points}; the first numbers must ascend from point to point"
                raise Invalid((name, "points"), text, "inlet")
        if isinstance(fluid, Stratified):
            if len(fluid.bounds) != len(fluid.fluids) - 1:
                text = f"has {len(fluid.bounds)} items for {len(fluid.fluids)} fluids; give one between each two"
                raise Invalid(("fluid", "bounds"), text, "inlet")
            if not (np.diff(fluid.bounds) > 0).all():
                raise Invalid(("fluid", "bounds"), f"is {fluid.bounds} m; they must ascend", "inlet")
        if callable(pressure):
            given["pressure"] = Uniform(pressure)
        return self.kinds[key](**given)

    def check(self, made: Sequence[Opening], room: bool) -> None:
        """See `Listed.check`."""
        check_balance(made, room)

    def content(self, one: Opening, values: Mapping[str, Any]) -> dict[str, Any]:
        """See `Listed.content`: without a name that is the default."""
        usual = default_name(one.kind, one.wall)
        return {key: value for key, value in values.items() if key != "name" or value != usual}

    def record(self, one: Opening, values: dict[str, Any]) -> dict[str, Any]:
        """See `Listed.record`: with its fluid by name."""
        if isinstance(values.get("fluid"), Mapping) and "name" in values["fluid"]:  # no function to names
            values["fluid"] = values["fluid"]["name"]
        return {"name": one.name, "kind": one.kind, "values": values}

    def restored(self, record: Mapping[str, Any]) -> Any:
        """See `Listed.restored`."""
        return self.kinds[f"{record['kind']}s"](**record["values"])

    def facts(self, case: Case) -> dict[str, Any]:
        """See `Listed.facts`: name, kind, ends (2, 2) [m], and the unit vector into the tank, inwards.

        An inlet that draws off "drains"; those with a valve have the times in which it is "open" (K, 2) [s].
        """
        found: list[dict[str, Any]] = []
        for line in case.boundary.lines:
            one = line.opening
            draws = isinstance(one, Inlet) and one.open is None and one.strength(one.ramp, line.size) < 0
            fact = {"name": one.name, "kind": one.kind, "ends": [line.a.tolist(), line.b.tolist()]}
            found.append({**fact, "inwards": line.inwards.tolist(), **({"drains": True} if draws else {})})
            if one.open is not None:
                found[-1]["open"] = [list(pair) for pair in one.open]
        return {"openings": found} if found else {}

    def steered(self, case: Case) -> dict[str, list[Any]]:
        """See `Listed.steered`."""
        all_of_them = [{"name": one.name, "kind": one.kind} for one in case.openings]
        return {"valve": all_of_them, "discharge": [one for one in all_of_them if one["kind"] == Inlet.kind]}

    def lines(self, case: Case) -> list[str]:
        """See `Listed.lines`: what passes, how fast, and what the spacing resolves."""
        found, passages = [], case.boundary.passages
        for line, on in zip(case.boundary.lines, passages.nodes if passages is not None else [], strict=True):
            opening = line.opening
            width = f"{line.length:.4g} m wide, {len(on) - 1} spacings"
            if isinstance(opening, Inlet):
                if opening.pump:
                    raised = "" if opening.head is None else ", raised by a curve of heads"
                    if is_number(opening.head):
                        raised = f", raised by {opening.head:g} m"
                    found.append(f"{opening.name}: what leaves by {opening.pump}{raised}; {width}")
                    continue
                x = case.particles.position[on]
                v = line.speeds(x, opening.ramp)
                discharge = float((line.edge_means(x, v) * np.diff(line.coordinates(x))).sum())
                kind = opening.entering(x, 0.0, [fluid.name for fluid in case.fluids])
                entering = [case.fluids[k] for k in np.unique(kind)]
                mean, gravity = discharge / line.size, float(np.linalg.norm(case.gravity))
                across = line.length * (2 if line.begins_on_axis else 1)  # a diameter
                numbers_of = [f"Froude number {abs(mean) / math.sqrt(gravity * across):.2g}"] if gravity else []
                viscosity = typical_viscosity(entering[0]) / entering[0].density
                numbers_of += [f"Reynolds number {abs(mean) * across / viscosity:.2g}"] if viscosity else []
                text = f"{' and '.join(fluid.name for fluid in entering)}, {discharge:.4g} {line.unit}, {mean:.3g} m/s "
                text += f"in the mean and {np.abs(v).max():.3g} m/s at most; {width}"
                text += "".join(f"; {number}" for number in numbers_of)
                assert isinstance(case.boundary.domain, Domain)
                volume = case.boundary.domain.measure(case.period)
                text += f"; the tank's volume in {abs(volume / discharge):.3g} s" if discharge else ""
            else:
                assert isinstance(opening, Outlet)
                pressure = opening.pressure
                held = "a pressure by a function" if callable(pressure) else f"{pressure} pressure"
                if not (callable(pressure) or isinstance(pressure, str)):
                    held = f"{pressure or 0.0:g} Pa"
                if opening.level is not None:
                    held = "a level by a function" if callable(opening.level) else f"a level of {opening.level:g} m"
                text = f"{held}, {'at right angles' if opening.normal(len(case.fluids)) else 'freely'}; {width}"
            if opening.open is not None:
                text += f"; open {', '.join(f'{start:g} to {end:g} s' for start, end in opening.open)}"
            found.append(f"{opening.name}: {text}")
        return found

    def hints(self, case: Case) -> list[str]:
        """Lines on inlets that set off at once while the fluids are at rest, drowned openings, and vents in liquids."""
        passages, particles, found = case.boundary.passages, case.particles, list[str]()
        if len(case.openings) == 1 and not case.has_room and isinstance(alone := case.openings[0], Inlet):
            text = "is the only opening of a full tank: as much leaves by it as enters; add a vent or an outlet"
            found.append(f"{alone.name} {text}")
        lightest = min(fluid.density for fluid in case.fluids)
        for line, on in zip(case.boundary.lines, passages.nodes if passages is not None else [], strict=True):
            opening = line.opening
            if isinstance(opening, Inlet) and not particles.velocity[~particles.wall].any():
                speed = float(np.abs(line.speeds(particles.position[on], 0.0)).max())
                if speed > 0:
                    text = f"sets off at {speed:.3g} m/s at t = 0, an impact; ramp = 0.1 begins smoothly"
                    found.append(f"{opening.name} {text}")
            if isinstance(opening, Outlet) and opening.level is not None and case.gravity[-1] < 0:
                top, level = max(float(line.a[1]), float(line.b[1])), opening.level_at(0.0)
                if level > top + 0.5 * particles.spacing:
                    text = f"has a level of {level:g} m, above its upper end at {top:g} m"
                    found.append(f"{opening.name} {text}: it is drowned, and only its own fluid enters")
            if isinstance(opening, Vent):
                liquid = case.fluids[int(np.median(particles.fluid[on]))]
                if liquid.density > LIQUID * lightest:
                    text = f"{opening.name} is in {liquid.name} at the start"
                    found.append(f"{text}, which leaves by it; vents are for gases")
        return found
