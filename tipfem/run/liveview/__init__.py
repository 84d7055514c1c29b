"""A running simulation in the viewer: its latest state in shared memory, drawn and served by a second process.

The run writes its state to memory that both processes have, only when somebody looks, and reads commands from a pipe
between two steps. The second process, which imports no solver, draws and serves the page. It ends with the run; if it
ends before, the run goes on.
"""

from .memory import Snapshot, StateMemory

__all__ = ["Snapshot", "StateMemory"]
