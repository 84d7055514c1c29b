"""Oil on water: a column of two fluids with a free surface collapses.

The position-based PFEM of Carvalho & Sanches, "Analysis of two-phase flows using position-based PFEM formulation",
with both of its kinds of boundary at once: an interface, between water and the oil that floats on it, and free
surfaces, where the alpha-shape ends and pressure is zero. The column is that of their dam break (section 4.2), half of
it oil. Nobody has measured it; what is checked is what must be so: each fluid keeps its volume, the oil stays on top
until the water climbs the far wall, energy only falls, and the front comes close to that of water alone (Martin & Moyce
1952; sources in demos/validation/dam_break), for the oil is nearly as heavy.

    python demos/oil_on_water.py --spacing 0.01 --end-time 0.3
"""

from tipfem.demos import harness
from tipfem.demos.support.checks import OilStaysOnTop

import tipfem as tp

# Resolution. All of these can be changed on the command line.
options = harness.options(
    __doc__,
    spacing=0.005,  # [m]
    time_step=1e-3,  # the largest; it adapts below [s]
    end_time=0.5,  # [s]
    frames_per_second=125.0,  # of simulated time
    interface=None,  # with a free surface there is one rule
    out="out/oil_on_water",
)

# Fluids: water, and an oil like that of sunflowers, at 20 degrees Celsius.
water = tp.Fluid("water", density=998.2, viscosity=1.002e-3)
oil = tp.Fluid("oil", density=920.0, viscosity=0.06)

# Geometry: a column 0.146 m wide and twice as high, its lower half water; the rest of the tank stays empty.
tank = tp.tank(size=(0.584, 0.4), spacing=options.spacing)
tank.fill(water, box=((0, 0), (0.146, 0.146)))
tank.fill(oil, box=((0, 0.146), (0.146, 0.292)))
case = tp.Case(
    tank,
    fluids=[water, oil],
    gravity=(0, -9.81),
    free_surface=True,
    # The layers become thin: what remeshing moves across their interface is given back faster than by default.
    numerics=tp.Numerics(volume_correction=3.0),
    title="A column of oil and water",
)

# Run. The harness runs the case, checks and draws it. Without the harness:
#     tp.init()
#     tp.Simulation(case, out="out/oil_on_water", time_step=1e-3, output_interval=0.008).run(0.5)
harness.run(case, options, check=OilStaysOnTop())
