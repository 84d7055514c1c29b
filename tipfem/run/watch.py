"""Watch: what may make the results of a run worse, told when it happens, each once."""

from __future__ import annotations

import logging
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping

import numpy as np

from tipfem.case.case import Case
from tipfem.logs import log
from tipfem.step.numerical_error import AT_REST, SUCTION
from tipfem.step.observer import Observer
from tipfem.step.stepper import Row, Stepper
from tipfem.typing import Array

TAKEN = 0.05  # part of the flow's energy
CHANGED = 0.005  # part of a volume
KEPT = 0.7  # part of the speeds given at the start, root mean square, that the first step is to leave
SETTLED = 20  # steps from which on a flow has energies of its own
HELD = 10  # steps in a row under suction; in impacts single ones are


class Watch(Observer):
    """Warnings of backflow, suction, lost starts, and energy and volume lost to numerics; by ``say`` and in the log."""

    def __init__(self, case: Case) -> None:
        self._case = case
        self.say: Callable[[str], None] = lambda _text: None
        self.look_back(())

    def look_back(self, history: Iterable[Mapping[str, float]], flow: Stepper | None = None) -> None:
        """Start from the rows of a history and the flow after it, of which all has been told."""
        self._told, self._steps, self._held, self._taken, self._brought = set[str](), 0, 0, 0.0, 0.0
        self._largest = np.zeros(len(self._case.fluids))
        self._out: dict[str, float] = defaultdict(float)
        self._in: dict[str, float] = defaultdict(float)
        self._ranges: dict[str, tuple[float, float]] = {"kinetic_energy": (0.0, 0.0)}
        for row in history:
            self._told |= {name for name, _ in self._found(row)}
        if flow is not None:
            self._told |= {name for name, _ in self._off(flow)}

    def after_step(self, flow: Stepper, row: Row) -> None:
        """Report faults that begin in the step."""
        first = self._projected(flow) if row["step"] == 1 else []
        for name, text in [*first, *self._found(row), *self._off(flow)]:
            if name not in self._told:
                self._told.add(name)
                line = f"warning: t = {row['time']:.6g} s: {text}"
                self.say(line)
                log(logging.WARNING, "warning", line, {"t": row["time"], "step": row["step"], "what": name})

    def _projected(self, flow: Stepper) -> list[tuple[str, str]]:
        """Velocities given at the start that no incompressible flow between the walls has."""
        given, left = (_speed(state.velocity) for state in (self._case.particles, flow.state.particles))
        if left >= KEPT * given:
            return []
        text = f"the first step leaves {left:.2g} of {given:.2g} m/s, the mean speeds given at the start (root mean "
        return [("start", text + "square): they lead through walls, or change volumes")]

    def _off(self, flow: Stepper) -> list[tuple[str, str]]:
        """Fluids whose volumes are not what they should be: by name, and in words."""
        state, found = flow.state, []
        self._largest = np.maximum(self._largest, state.wanted_volume)
        more = (state.volume - state.wanted_volume) / np.maximum(self._largest, 1e-300)
        for k in np.flatnonzero(np.abs(more) > CHANGED).tolist():
            name, verb = self._case.fluids[k].name, "made" if more[k] > 0 else "taken"
            text = f"numerics have {verb} {100 * abs(more[k]):.2g} % of the volume of {name}"
            if self._case.interface == "interpolated" and len(self._case.fluids) > 1:
                text += ": with the interpolated interface each remeshing moves some; interface = 'sharp' keeps it"
            found.append((f"volume_{name}", text))
        return found

    def _found(self, row: Mapping[str, float]) -> list[tuple[str, str]]:
        """Faults found after one more step: by name, and in words."""
        self._steps += 1
        for name, value in row.items():
            if name.startswith("through_"):
                self._out[name] += min(value, 0.0)
                self._in[name] += max(value, 0.0)
        found = list(self._case.came_back([self._out, self._in]).items() if self._out else ())
        low = row.get("lowest_pressure", 0.0)
        self._held = self._held + 1 if low < -SUCTION * row.get("highest_pressure", 0.0) else 0
        if self._held == HELD:
            text = (
                f"the fluid has held together at {-low:.2g} Pa below the pressure of the empty space for {HELD} steps: "
            )
            found.append(("suction", text + "no cavity opens in it, and it does not part from walls"))
        self._taken += row["numerical_dissipation"] - row["energy_residual"]
        self._brought += row.get("opening_work", 0.0) + row.get("opening_energy", 0.0)
        for name in ("kinetic_energy", "potential_energy", "surface_energy"):
            if name in row:
                low, high = self._ranges.get(name, (row[name], row[name]))
                self._ranges[name] = min(low, row[name]), max(high, row[name])
        own = max(high - low for low, high in self._ranges.values()) + max(self._brought, 0.0)
        rest = AT_REST * max(abs(value) for ends in self._ranges.values() for value in ends)
        if self._steps >= SETTLED and own > rest and abs(self._taken) > TAKEN * own:
            verb = "taken" if self._taken > 0 else "added"
            text = f"numerics have {verb} {abs(self._taken):.3g} J, {100 * TAKEN:.0f} % of what the flow has had so far"
            found.append(("energy", text))
        return found


def _speed(velocity: Array) -> float:
    """Root mean square of velocities (N, d) [m/s]."""
    return float(np.sqrt((velocity**2).sum(axis=1).mean()))
