"""Dam break of water in three dimensions, with a free surface.

The check holds that the water keeps its volume, that its energy rises by no more than 2 % above that of the start, and
that its front does not run faster than 2 sqrt(g h), the speed of a front without friction on a dry floor (Ritter 1892),
but does reach the far wall.

    tipfem demo dam_break_3d --spacing 0.1

The case is demos/cases/dam_break_3d.toml; `tipfem run` runs it without the check.
"""

from tipfem.demos import harness
from tipfem.demos.support.checks import Collapse

main = harness.Demo("dam_break_3d.toml", check=Collapse)

if __name__ == "__main__":
    harness.command(__name__)
