"""Floating: a box and a log, moored by springs, in the waves of a column of water that collapses.

Rigid bodies whose motions are solved together with the fluids: the box has half the density of water, the log a
fifth. The history has their positions, angles and velocities, and the forces of the fluids on them.

    tipfem demo floating --spacing 0.015 --until 3

The case is demos/cases/floating.toml; `tipfem run` runs it without the check.
"""

from tipfem.demos import harness

main = harness.Demo("floating.toml", strip=(0.0, 0.4, 0.8, 1.6))

if __name__ == "__main__":
    harness.command(__name__)
