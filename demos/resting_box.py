"""A dam break pushes a box that stands on the floor of the tank.

    tipfem demo resting_box --spacing 0.03 --until 0.4

Until the water is there the box carries its weight and does not move. Then it slides, and the friction below it is
Coulomb's.

The case is demos/cases/resting_box.toml; `tipfem run` runs it without the check.
"""

from tipfem.demos import harness
from tipfem.demos.support.passing import PushedBox

main = harness.Demo("resting_box.toml", check=PushedBox(0.4, 0.3), strip=(0.0, 0.24, 0.32, 0.48, 0.64, 0.88))

if __name__ == "__main__":
    harness.command(__name__)
