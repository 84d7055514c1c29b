"""Dam break of water in air, in a closed tank.

The case of section 4.2 of Carvalho & Sanches, "Analysis of two-phase flows using position-based PFEM formulation": a
column of water collapses under gravity and runs along the floor of a tank full of air. The front is compared with the
experiments of Martin & Moyce (1952) and Koshizuka & Oka (1996), the height of the column with Martin & Moyce; see
demos/validation/dam_break.

    python demos/dam_break.py --spacing 0.01 --until 0.3

With --air-spacing particles stand farther apart in the air, the farther from the water: as good a front, for a part
of the time.

    python demos/dam_break.py --spacing 0.002 --air-spacing 0.02

The case is demos/cases/dam_break.toml; `tipfem run` runs it without the check.
"""

from tipfem.demos import harness
from tipfem.demos.validation.dam_break.check import DamBreak

main = harness.Demo(
    "dam_break.toml",
    check=DamBreak(),
    strip=(0.0, 0.1, 0.2, 0.25, 0.3, 0.4, 0.6, 1.0),
    keys={
        "air_spacing": (
            "grading.largest.air",
            "distance between particles in the air, far from the water [m]; by default that of all.",
        )
    },
)

if __name__ == "__main__":
    harness.command(__name__)
