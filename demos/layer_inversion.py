"""Layers that turn over: glycerin above water, in a closed tank.

The second case of section 4.1 of Carvalho & Sanches, "Analysis of two-phase flows using position-based PFEM
formulation": the heavier fluid lies on top and falls through the lighter one, until both are almost at rest, the other
way round. The pressure at the end is compared with that of the inverted layers at rest, see demos/validation/layers.

    python demos/layer_inversion.py --spacing 0.005
"""

import numpy as np
from tipfem.demos import harness
from tipfem.demos.validation.layers.check import LayersTurnOver

import tipfem as tp

# Resolution. All of these can be changed on the command line.
options = harness.options(
    __doc__,
    spacing=0.002,  # [m]
    time_step=0.01,  # the largest; it adapts below [s]
    end_time=40.75,  # that of the paper [s]
    frames_per_second=4.0,  # of simulated time
    interface="interpolated",  # that of the paper; at 5 mm the sharp one leaves films on the walls, a particle wide
    out="out/layer_inversion",
)

# Fluids, at 20 degrees Celsius.
glycerin = tp.Fluid("glycerin", density=1261.0, viscosity=1.412)
water = tp.Fluid("water", density=998.2, viscosity=1.002e-3)

# Geometry: each fluid fills half of a square tank. Layers in exact balance would stay where they are: the interface
# starts as a wave.
edge, amplitude = 0.1, 0.005  # [m]
tank = tp.tank(size=(edge, edge), spacing=options.spacing)
tank.fill(water)
tank.fill(glycerin, where=lambda x: x[:, 1] > edge / 2 + amplitude * np.cos(2 * np.pi * x[:, 0] / edge))
for side in ("left", "right", "bottom", "top"):
    tank.wall(side, law="no-slip")  # the glycerin's layer is thick, and it has to run off the walls
case = tp.Case(
    tank,
    fluids=[glycerin, water],
    gravity=(0, -9.81),
    interface=options.interface,
    # Volumes are corrected twice as fast as by default: every remeshing changes them while the interface is torn.
    numerics=tp.Numerics(volume_correction=2.0),
    title="Glycerin above water",
)

# Run. The harness runs the case, compares it with hydrostatics and draws it. Without the harness:
#     tp.init()
#     tp.Simulation(case, out="out/layer_inversion", time_step=0.01, output_interval=0.25).run(40.75)
harness.run(
    case,
    options,
    check=LayersTurnOver(glycerin, water, edge),
    strip=(0.0, 0.5, 1.0, 1.5, 2.0, 4.0, 10.0, options.end_time),
)
