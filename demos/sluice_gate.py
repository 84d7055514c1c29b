"""Sluice gate: water from a reservoir runs below a gate, and leaves as a jet by an open end.

    tipfem demo sluice_gate --spacing 0.0125 --until 2

The coefficient of discharge, q / (a sqrt(2 g y)) with the opening a of the gate and the depth y before it, is compared
with Cc / sqrt(1 + Cc a / y) and the contraction Cc = 0.61 of potential theory. The case is
demos/cases/sluice_gate.toml; `tipfem run` runs it without the check.
"""

from tipfem.demos import harness
from tipfem.demos.support.passing import Gate

main = harness.Demo("sluice_gate.toml", check=Gate(0.075, 0.5, "outlet_end"), strip=(0.2, 0.5, 1.0, 2.0))

if __name__ == "__main__":
    harness.command(__name__)
