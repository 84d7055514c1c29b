"""Dam break behind a gate that stands on the floor of the tank, and is lifted.

    tipfem demo dam_break_gate --spacing 0.025 --until 0.3

Before the gate moves the water is at rest, and its force on the gate is that of its weight. Then the front runs below
the gate, at most at the speed 2 sqrt(g H) of Ritter's solution.

The case is demos/cases/dam_break_gate.toml; `tipfem run` runs it without the check.
"""

from tipfem.demos import harness
from tipfem.demos.support.passing import LiftedGate

main = harness.Demo("dam_break_gate.toml", check=LiftedGate(0.6, 0.3, 0.05), strip=(0.0, 0.1, 0.152, 0.252, 0.5))

if __name__ == "__main__":
    harness.command(__name__)
