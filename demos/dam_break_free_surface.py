"""Dam break of water with a free surface: one fluid, and nothing around it.

The column of section 4.2 of Carvalho & Sanches, "Analysis of two-phase flows using position-based PFEM formulation",
in the same tank, but without the air: where the water ends, pressure is zero (the alpha-shape of their section 3). The
front is compared with the experiments of Martin & Moyce (1952) and Koshizuka & Oka (1996), the height of the column
with Martin & Moyce; see demos/validation/dam_break.

    tipfem demo dam_break_free_surface --spacing 0.01 --until 0.3

The case is demos/cases/dam_break_free_surface.toml; `tipfem run` runs it without the check.
"""

from tipfem.demos import harness
from tipfem.demos.validation.dam_break.check import DamBreak

main = harness.Demo("dam_break_free_surface.toml", check=DamBreak(free_surface=True))

if __name__ == "__main__":
    harness.command(__name__)
