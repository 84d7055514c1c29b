"""Oil on water: a column of two fluids with a free surface collapses.

The position-based PFEM of Carvalho & Sanches, "Analysis of two-phase flows using position-based PFEM formulation",
with both of its kinds of boundary at once: an interface, between water and the oil that floats on it, and free
surfaces, where the alpha-shape ends and pressure is zero. The column is that of their dam break (section 4.2), half of
it oil. Nobody has measured it; what is checked is what must be so: each fluid keeps its volume, the oil stays on top
until the water climbs the far wall, energy only falls, and the front comes close to that of water alone (Martin & Moyce
1952; sources in demos/validation/dam_break), for the oil is nearly as heavy.

    tipfem demo oil_on_water --spacing 0.01 --until 0.3

The case is demos/cases/oil_on_water.toml; `tipfem run` runs it without the check.
"""

from tipfem.demos import harness
from tipfem.demos.support.checks import OilStaysOnTop

main = harness.Demo("oil_on_water.toml", check=OilStaysOnTop())

if __name__ == "__main__":
    harness.command(__name__)
