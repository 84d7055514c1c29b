"""Commands to openings: their valves, and the discharge of inlets."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar

from tipfem.case.case import Case
from tipfem.case.declaration import Unit
from tipfem.run.steering.commands import Command

if TYPE_CHECKING:
    from tipfem.step.stepper import Stepper  # which starts Taichi


@dataclass(frozen=True)
class _OpeningCommand(Command):
    """Sets what an opening was told, the value of the command's last field."""

    of_inlets: ClassVar[bool]  # whether it is for inlets only

    opening: str

    def require(self, case: Case) -> None:
        """See `Command.require`."""
        names = [one.name for one in case.openings if one.velocities or not self.of_inlets]
        if self.opening not in names:
            text = f"opening is {self.opening!r}; it must be one of {', '.join(names) or 'none: there is none'}"
            raise ValueError(f"{self.name}: {text}")

    def apply(self, simulation: Stepper) -> None:
        """See `Command.apply`; it is refused if a closed tank would gain volume."""
        from tipfem.physics.openings.lines import OpeningLines
        from tipfem.physics.openings.passed import Passed

        state, number = simulation.state, [one.name for one in simulation.case.openings].index(self.opening)
        part = state.part(Passed)
        assert part is not None
        values = getattr(part, self.name).copy()
        _, values[number] = self.values().values()
        changed = dataclasses.replace(part, **{self.name: values})
        if text := OpeningLines(simulation.case).setting(changed, state.time).unbalanced(state.time):
            raise ValueError(f"{self.name}: {text}")
        simulation.state = dataclasses.replace(state, parts={**state.parts, "openings": changed})


@dataclass(frozen=True)
class Discharge(_OpeningCommand):
    """Another discharge of an inlet from now on, with its profile and valve. A large change is an impact.

    Args:
        opening: name of the inlet.
        value: what enters; less than 0 for what is drawn off [m^2/s].

    Raises:
        ValueError: the name is no text, or the value is no number.
    """

    value: Annotated[float, Unit("m^2/s")]
    name = "discharge"
    of_inlets = True


@dataclass(frozen=True)
class Valve(_OpeningCommand):
    """An opening is open, or closed, from now on, whatever the case says of its valve.

    Args:
        opening: name of the inlet, outlet or vent.
        open: whether it is open.

    Raises:
        ValueError: the name is no text, or ``open`` is not True or False.
    """

    open: bool
    name = "valve"
    of_inlets = False
