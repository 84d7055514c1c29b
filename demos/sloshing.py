"""Sloshing: a standing wave of small amplitude on water with a free surface, between walls that slip.

The position-based PFEM of Carvalho & Sanches, "Analysis of two-phase flows using position-based PFEM formulation",
with one fluid and nothing above it. A wave of one half length in the tank is let go from rest; its period and its
damping are compared with linear theory, see demos/validation/sloshing.

    tipfem demo sloshing --spacing 0.05 --until 2.4

The case is demos/cases/sloshing.toml; `tipfem run` runs it without the check.
"""

from tipfem.demos import harness
from tipfem.demos.validation.sloshing.check import StandingWave

main = harness.Demo(
    "sloshing.toml", check=lambda case: StandingWave(case.fluids[0], length=1.0, depth=0.5, amplitude=0.01)
)

if __name__ == "__main__":
    harness.command(__name__)
