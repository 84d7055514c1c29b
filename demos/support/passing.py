"""Checks of demos whose fluids enter and leave the tank, pass a gate, or push a box."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from tipfem.demos.harness import Check, Options, Probe, above

import tipfem as tp
from tipfem.geometry.plane.touching import SKIN
from tipfem.mesh.measures import depth

LARGEST_IMBALANCE = 1e-9  # of the volumes of the fluids, relative to what has passed
ROUND_OFF = 1e-13  # of the volumes of all fluids
LARGEST_FORCE_ERROR = 5e-5  # of that of the weight, on a closed gate
LARGEST_SPEED_AT_REST = 1e-10  # of the water behind it [m/s]
LARGEST_CONTACT_ERROR = 1e-4  # of a body's weight and friction, relative
LARGEST_LIFT = 1e-2  # of a body that slides along the floor [spacings]
LARGEST_CREEP = 1e-7  # before the water comes [m]
SLIDES = 0.02  # speed from which a body slides [m/s]
CONTRACTION = 0.61  # of the jet below a sharp gate, from potential theory (von Mises)


class Balance(Check):
    """The volumes of the fluids change by what passes the openings."""

    def figures(self, simulation: tp.Simulation) -> dict[str, float]:
        """See `Check.figures`."""
        state, history = simulation.state, simulation.history
        moved = sum(abs(value) for row in history for name, value in row.items() if name.startswith("through_"))
        error = max(np.abs(state.volume - state.wanted_volume).max() - ROUND_OFF * state.volume.sum(), 0.0)
        return {"passed": moved, "imbalance": float(error / moved) if moved else 0.0}

    def missed(self, figures: Mapping[str, float], options: Options) -> list[str]:
        """See `Check.missed`."""
        found = figures["imbalance"]
        return [] if found <= LARGEST_IMBALANCE else [f"volumes differ by {found:.1e} from what has passed"]


class Gate(Balance):
    """The discharge below a sluice gate, as a coefficient of that of Torricelli's speed in its opening.

    Args:
        opening: height of the lip above the floor [m].
        gate: place of the gate [m].
        outlet: name of the opening by which the water leaves.
    """

    def __init__(self, opening: float, gate: float, outlet: str) -> None:
        self.opening, self.gate, self.outlet = opening, gate, outlet

    def columns(self) -> dict[str, Probe]:
        """See `Check.columns`: the depth of the water in the reservoir [m]."""
        return {"depth": lambda run: depth(run.mesh, run.particles.fluid, 0, 0.5 * self.gate)}

    def figures(self, simulation: tp.Simulation) -> dict[str, float]:
        """See `Check.figures`; means over the second half of the run."""
        rows = [row for row in simulation.history if row["time"] > 0.5 * simulation.time]
        time = sum(row["time_step"] for row in rows)
        leaves = -sum(row[f"through_{self.outlet}_water"] for row in rows) / time
        level = sum(row["depth"] * row["time_step"] for row in rows) / time
        coefficient = leaves / (self.opening * math.sqrt(2 * 9.81 * level))
        theory = CONTRACTION / math.sqrt(1 + CONTRACTION * self.opening / level)
        return {**super().figures(simulation), "coefficient": coefficient, "theory": theory}

    def missed(self, figures: Mapping[str, float], options: Options) -> list[str]:
        """See `Check.missed`: the coefficient is looked at where the jet has come to the outlet."""
        found, wanted = figures["coefficient"], figures["theory"]
        late = options.end_time >= 1.8 and options.spacing <= 0.013
        wrong = late and not abs(found / wanted - 1) < 0.04
        line = f"the coefficient of discharge is {found:.3f}, not {wanted:.3f} within 4 %"
        return [*super().missed(figures, options), *([line] if wrong else [])]


class LiftedGate(Check):
    """Water at rest behind a gate, and the front that runs out when the gate is lifted.

    Args:
        place: of the gate [m].
        depth: of the water [m].
        start: when the gate begins to move [s].
    """

    def __init__(self, place: float, depth: float, start: float) -> None:
        self.place, self.depth, self.start = place, depth, start

    def columns(self) -> dict[str, Probe]:
        """See `Check.columns`: how far the water has come [m]."""
        return {"front": lambda run: float(run.particles.position[np.unique(run.mesh.cells), 0].max())}

    def figures(self, simulation: tp.Simulation) -> dict[str, float]:
        """See `Check.figures`."""
        rows, skin = simulation.history, SKIN * simulation.particles.spacing
        before = [row for row in rows if row["time"] < self.start]
        late = [row for row in rows if row["front"] > self.place + self.depth]
        # On the gate, a skin above the floor, and on half of the mouth below it.
        square = (self.depth - skin) ** 2 + skin * (self.depth - 0.5 * skin)
        weight = 0.5 * square * 9.81 * simulation.case.fluids[0].density
        speed = math.nan
        if len(late) > 1:
            speed = (late[-1]["front"] - late[0]["front"]) / (late[-1]["time"] - late[0]["time"])
        return {
            "force": before[-1]["gate_force_x"] / weight if before else math.nan,
            "speed_at_rest": max((row["max_speed"] for row in before), default=math.nan),
            "front_speed": speed / math.sqrt(9.81 * self.depth),
            "volume_error": simulation.state.volume_error,
        }

    def missed(self, figures: Mapping[str, float], options: Options) -> list[str]:
        """See `Check.missed`: the front's speed is looked at where it has run for the depth of the water."""
        found = []
        if abs(figures["force"] - 1) > LARGEST_FORCE_ERROR:
            found.append(f"the closed gate bears {figures['force']:.6f} of the water's weight, not 1")
        if figures["speed_at_rest"] > LARGEST_SPEED_AT_REST:
            found.append(f"the water moves at {figures['speed_at_rest']:.1e} m/s before the gate does")
        if figures["volume_error"] > LARGEST_IMBALANCE:
            found.append(f"the volume is {figures['volume_error']:.1e} off")
        if not math.isnan(figures["front_speed"]) and not 0.8 < figures["front_speed"] < 2.0:
            found.append(f"the front runs at {figures['front_speed']:.2f} sqrt(g H), not at 0.8 to 2")
        return found


class PushedBox(Check):
    """A body "box" at rest until water has come, which then slides with Coulomb's friction.

    Args:
        distance: from the water to the box at the start [m].
        depth: of the water [m].
    """

    def __init__(self, distance: float, depth: float) -> None:
        self.arrives = distance / (2 * math.sqrt(9.81 * depth))  # Ritter's front, which none is faster than

    def figures(self, simulation: tp.Simulation) -> dict[str, float]:
        """See `Check.figures`."""
        (box,), rows = simulation.case.bodies, simulation.history
        weight, spacing = box.total_mass * 9.81, simulation.particles.spacing
        before = [row for row in rows if row["time"] < self.arrives]
        slides = [row for row in rows if row["box_velocity_x"] > SLIDES and not row["impact"]]
        friction = [abs(row["box_contact_force_x"] / (box.friction * row["box_contact_force_y"]) + 1) for row in slides]
        rest = [abs(row["box_contact_force_y"] / weight - 1) for row in before]
        return {
            "weight": max(rest, default=math.nan),
            "friction": max(friction, default=math.nan),
            "lifted": max(abs(row["box_y"] - rows[0]["box_y"]) for row in rows) / spacing,
            "moved_before": max((abs(row["box_x"] - rows[0]["box_x"]) for row in before), default=math.nan),
            "moved": rows[-1]["box_x"] - rows[0]["box_x"],
        }

    def missed(self, figures: Mapping[str, float], options: Options) -> list[str]:
        """See `Check.missed`: what the run is too short for is not looked at."""
        limits = dict.fromkeys(("weight", "friction"), LARGEST_CONTACT_ERROR)
        limits |= {"lifted": LARGEST_LIFT, "moved_before": LARGEST_CREEP}
        return above({name: value for name, value in figures.items() if not math.isnan(value)}, limits)
