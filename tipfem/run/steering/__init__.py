"""Steering: commands to a simulation between two steps, written to a file from which they are repeated.

`Gravity`, `Poke`, `Release`, `Drop`, `Viscosity` and others change the physics: `Simulation.steer` takes them, and
writes them with the number of the step to steering.jsonl in the results folder; ``Simulation(..., steering=file)``
repeats them there.
`Pause`, `Go`, `Advance` and `Stop` change when steps are taken, not what they compute: a `RunControl` takes those.
"""

from .commands import (
    LARGEST_ACCELERATION,
    Advance,
    Command,
    Drop,
    Go,
    Gravity,
    MoveWall,
    Pause,
    Poke,
    Release,
    Stop,
    SurfaceTension,
    Viscosity,
    command_from,
    limits,
    steered_walls,
    tensions,
)
from .control import RunControl
from .openings import Discharge, Valve
from .record import FILE, Record, read_records
from .steering import Steering

__all__ = [
    "FILE",
    "LARGEST_ACCELERATION",
    "Advance",
    "Command",
    "Discharge",
    "Drop",
    "Go",
    "Gravity",
    "MoveWall",
    "Pause",
    "Poke",
    "Record",
    "Release",
    "RunControl",
    "Steering",
    "Stop",
    "SurfaceTension",
    "Valve",
    "Viscosity",
    "command_from",
    "limits",
    "read_records",
    "steered_walls",
    "tensions",
]
