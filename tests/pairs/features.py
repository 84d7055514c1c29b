"""Features of cases, each a change of a small tank of water and air, so that any two can be put together."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable
from typing import Any

Content = dict[str, Any]
FEATURES: dict[str, Callable[[Content], None]] = {}


def feature(change: Callable[[Content], None]) -> Callable[[Content], None]:
    """Put a change among the features; those above are made first, and those below see what they made."""
    FEATURES[change.__name__] = change
    return change


def base() -> Content:
    """A column of water in a closed tank of air, some 300 particles."""
    return {
        "gravity": [0, -9.81],
        "fluids": {
            "water": {"density": 998.2, "viscosity": 1e-3},
            "air": {"density": 1.204, "viscosity": 1.825e-5},
        },
        "tank": {"size": [0.4, 0.3], "spacing": 0.02},
        "fill": [{"fluid": "air"}, {"fluid": "water", "box": [[0, 0], [0.2, 0.15]]}],
        "walls": {},
        "time": {"end": 100.0, "largest_step": 2e-3},
    }


def content(names: tuple[str, ...]) -> Content:
    """The tank with some features."""
    made = base()
    for name, change in FEATURES.items():
        if name in names:
            change(made)
    return made


def pairs() -> list[tuple[str, ...]]:
    """Each feature alone, and all pairs."""
    return [(name,) for name in FEATURES] + list(itertools.combinations(FEATURES, 2))


def toml(value: Any) -> str:
    """A value in TOML; tables in one line."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {toml(item)}" for key, item in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    return json.dumps(value)


def text(made: Content) -> str:
    """A content as a case file."""
    return "".join(f"{key} = {toml(value)}\n" for key, value in made.items())


def is_3d(c: Content) -> bool:
    return len(c["tank"].get("size", ())) == 3 or "corners" in c["tank"]


def is_free(c: Content) -> bool:
    return bool(c.get("free_surface"))


def wide(c: Content, *vector: float) -> list[float]:
    """A vector of as many dimensions as the case has."""
    return [*vector, *([0.0] if is_3d(c) else [])]


def pair_value(c: Content, value: Any) -> Content:
    """A value of the water's surface: to the air, or to empty space."""
    return {"water": value} if is_free(c) else {"water": {"air": value}}


def wall(c: Content, name: str) -> Content:
    return c["walls"].setdefault(name, {})


def walls(c: Content) -> list[str]:
    """Names of the walls there are."""
    across = {"x": [], "xy": []}.get(c["tank"].get("periodic"), ["left", "right"])
    upright = [] if c["tank"].get("periodic") == "xy" else ["bottom", "top"]
    return [*across, *upright, *(["front", "back"] if is_3d(c) else [])]


def shaped(c: Content, corners: list[list[float]], names: list[str], **more: Any) -> None:
    c["tank"].pop("size", None)
    c["tank"]["shape"] = {"corners": corners, "names": names, **more}


def vent(c: Content) -> None:
    """A vent, which a tank full of fluids needs where there are openings."""
    if not is_free(c) and "vents" not in c:
        ends = [[0.02, 0.3], [0.38, 0.3]] if "grading" in c else [wide(c, 0.2, 0.3), wide(c, 0.3, 0.3)]
        c["vents"] = [{"wall": "top", "between": ends}]


def sine(amplitude: Any, frequency: float = 1.0) -> Content:
    return {"form": "sine", "amplitude": amplitude, "frequency": frequency, "soft_start": 0.2}


# What determines the kind of case.


@feature
def space(c: Content) -> None:
    c["tank"].update(size=[0.2, 0.2, 0.16], spacing=0.04, jitter=0.1)
    c["gravity"], c["interface"] = [0, -9.81, 0], "interpolated"
    c["fill"][1]["box"] = [[0, 0, 0], [0.1, 0.1, 0.16]]


@feature
def sloping(c: Content) -> None:
    """A tank in 3-D with a slope, under water."""
    space(c)
    del c["tank"]["size"]
    outline = [[0.07, 0], [0.2, 0], [0.2, 0.2], [0, 0.2], [0, 0.07]]
    c["tank"]["corners"], c["interface"] = [[*corner, z] for corner in outline for z in (0, 0.16)], "sharp"


@feature
def free_surface(c: Content) -> None:
    c["free_surface"] = True
    del c["fluids"]["air"], c["fill"][0]


@feature
def interpolated(c: Content) -> None:
    c["interface"] = "interpolated"


@feature
def graded(c: Content) -> None:
    c["grading"] = {"largest": {"water": 0.04} if is_free(c) else {"air": 0.06}}


@feature
def films(c: Content) -> None:
    c.setdefault("grading", {})["film_resolution"] = 0.25 * c["tank"]["spacing"]


@feature
def periodic(c: Content) -> None:
    c["tank"]["periodic"] = "x"


@feature
def periodic_both(c: Content) -> None:
    c["tank"]["periodic"], c["gravity"] = "xy", [0, 0]
    c["fill"][-1] = {"fluid": "water", "disc": {"centre": [0.1, 0.15], "radius": 0.07}}


@feature
def slanted(c: Content) -> None:
    corners = [[0, 0], [0.4, 0], [0.4, 0.3], [0.1, 0.3], [0, 0.2]]
    shaped(c, corners, ["bottom", "right", "top", "slant", "left"])


@feature
def arc(c: Content) -> None:
    corners = [[0, 0.1], [0.1, 0.0], [0.4, 0], [0.4, 0.3], [0.0, 0.3]]
    shaped(c, corners, ["round", "bottom", "right", "top", "left"], arcs=[{"edge": 0, "centre": [0.1, 0.1]}])


@feature
def hole(c: Content) -> None:
    circle = {"circle": {"centre": [0.14, 0.2], "radius": 0.035}}
    corners = [[0, 0], [0.4, 0], [0.4, 0.3], [0, 0.3]]
    shaped(c, corners, ["bottom", "right", "top", "left"], holes=[circle])


@feature
def misfit(c: Content) -> None:
    """A level that no row of particles has."""
    c["fill"][-1] = {"fluid": "water", "box": [wide(c, 0, 0), [0.113, 0.117, 0.16] if is_3d(c) else [0.193, 0.127]]}


@feature
def three_fluids(c: Content) -> None:
    c["fluids"]["oil"] = {"density": 900.0, "viscosity": 0.05}
    box = [[0.1, 0, 0], [0.2, 0.06, 0.16]] if is_3d(c) else [[0.2, 0], [0.4, 0.06]]
    c["fill"].append({"fluid": "oil", "box": box})


# Laws of viscosity.


@feature
def bingham(c: Content) -> None:
    c["fluids"]["water"]["viscosity"] = {
        "law": "bingham",
        "yield_stress": 20.0,
        "viscosity": 0.5,
        "regularisation": 10.0,
    }


@feature
def power_law(c: Content) -> None:
    c["fluids"]["water"]["viscosity"] = {"law": "power", "consistency": 0.5, "index": 0.6}


@feature
def smagorinsky(c: Content) -> None:
    c["fluids"]["water"]["viscosity"] = {"law": "smagorinsky", "viscosity": 1e-3}


@feature
def granular(c: Content) -> None:
    law = {"law": "granular", "static_friction": 0.4, "fast_friction": 0.7, "diameter": 2e-3, "grain_density": 2500.0}
    c["fluids"]["water"]["viscosity"] = {**law, "regularisation": 10.0}


# Walls.


@feature
def slip(c: Content) -> None:
    for name in walls(c):
        wall(c, name)["slip"] = True


@feature
def slip_length(c: Content) -> None:
    for name in walls(c):
        wall(c, name).pop("slip", None)
        wall(c, name)["slip_length"] = 0.01


@feature
def boundary_layers(c: Content) -> None:
    for name in walls(c):
        wall(c, name).setdefault("law", "layer")


@feature
def no_slip(c: Content) -> None:
    for name in walls(c):
        wall(c, name).setdefault("law", "no-slip")


@feature
def lid(c: Content) -> None:
    wall(c, "top").pop("slip", None)
    wall(c, "top")["velocity"] = {"form": "ramp", "end_value": wide(c, 0.5, 0), "end_time": 0.1}


@feature
def piston(c: Content) -> None:
    wall(c, "left")["motion"] = sine(0.02)
    if not is_free(c):
        wall(c, "right")["motion"] = sine(-0.02)
    for name in ("top", "bottom"):
        wall(c, name)["slip"] = True


@feature
def wave_maker(c: Content) -> None:
    wall(c, "left").update(slip=True, motion={"form": "waves", "height": 0.02, "period": 0.5, "depth": 0.15})
    for name in ("top", "bottom"):
        wall(c, name)["slip"] = True
    vent(c)


@feature
def swaying(c: Content) -> None:
    turn = {} if is_3d(c) else {"angle": sine(0.05)}
    c["tank_motion"] = {"translation": sine(wide(c, 0.01, 0.0), 2.0), **turn}


@feature
def tension(c: Content) -> None:
    c["surface_tension"] = pair_value(c, 0.07)


@feature
def contact_angle(c: Content) -> None:
    tension(c)
    wall(c, "bottom")["contact_angle"] = pair_value(c, 70)


@feature
def hysteresis(c: Content) -> None:
    tension(c)
    wall(c, "bottom")["contact_angle"] = pair_value(c, [50, 80])


# Bodies.


@feature
def floating_body(c: Content) -> None:
    box = [[0.24, 0.1], [0.32, 0.16]]
    c.setdefault("bodies", []).append({"name": "box", "box": box, "density": 500.0})


@feature
def driven_body(c: Content) -> None:
    motion = {"translation": sine([0.01, 0.0], 2.0)}
    disc = {"centre": [0.14, 0.1], "radius": 0.03}
    c.setdefault("bodies", []).append({"name": "pad", "disc": disc, "motion": motion})


@feature
def wetted_body(c: Content) -> None:
    tension(c)
    disc = {"centre": [0.2, 0.12], "radius": 0.04}
    body = {"name": "disc", "disc": disc, "density": 700.0, "contact_angle": pair_value(c, 100)}
    c.setdefault("bodies", []).append(body)


# Openings.


@feature
def inlet(c: Content) -> None:
    moves = "motion" in c["walls"].get("left", {})
    place = {"wall": "bottom", "between": [[0.15, 0], [0.25, 0]]}
    if not moves:
        place = {"wall": "left", "between": [wide(c, 0, 0), wide(c, 0, 0.1)]}
    c.setdefault("inlets", []).append({**place, "fluid": "water", "discharge": 0.01, "ramp": 0.02})
    vent(c)


@feature
def outlet(c: Content) -> None:
    c.setdefault("outlets", []).append({"wall": "bottom", "between": [[0.04, 0], [0.14, 0]], "pressure": 0})
    vent(c)


@feature
def level_outlet(c: Content) -> None:
    c.setdefault("outlets", []).append({"wall": "right", "level": 0.1, "fluid": "water"})


@feature
def pump(c: Content) -> None:
    vent(c)
    c.setdefault("outlets", []).append({"wall": "bottom", "name": "drain", "between": [[0.04, 0], [0.14, 0]]})
    head = {"form": "polyline", "points": [[0, 0.4], [0.05, 0.1]]}
    into = {"wall": "right", "between": [[0.4, 0.2], [0.4, 0.28]], "fluid": "water"}
    c.setdefault("inlets", []).append({**into, "pump": "drain", "head": head})


@feature
def stratified_inlet(c: Content) -> None:
    layers = ["water", "water" if is_free(c) else "air"]
    fluid = {"form": "stratified", "fluids": layers, "bounds": [0.08]}
    into = {"wall": "right", "between": [[0.4, 0.02], [0.4, 0.14]], "fluid": fluid}
    c.setdefault("inlets", []).append({**into, "velocity": 0.2, "ramp": 0.02})
    vent(c)


@feature
def beach(c: Content) -> None:
    c.setdefault("beaches", []).append({"wall": "right", "length": 0.2, "period": 0.5})


# Forces, numerics and output.


@feature
def body_force(c: Content) -> None:
    c["body_force"] = {"form": "sine", "amplitude": wide(c, 1.0, 0.0), "frequency": 2.0}


def numerics(c: Content, **values: Any) -> None:
    c.setdefault("numerics", {}).update(values)


@feature
def two_pressures(c: Content) -> None:
    numerics(c, pressure="two-sided")


@feature
def matrix_free(c: Content) -> None:
    numerics(c, jacobian="matrix-free")


@feature
def detailed_budget(c: Content) -> None:
    numerics(c, budget="detailed")


@feature
def consistent_mass(c: Content) -> None:
    numerics(c, mass="consistent")


@feature
def no_sliding(c: Content) -> None:
    numerics(c, sliding=False)


@feature
def computed_fields(c: Content) -> None:
    c["output"] = {"fields": "both", "interval": 0.01, "quantities": ["vorticity", "shear_rate"]}
