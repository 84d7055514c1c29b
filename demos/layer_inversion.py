"""Layers that turn over: glycerin above water, in a closed tank.

The second case of section 4.1 of Carvalho & Sanches, "Analysis of two-phase flows using position-based PFEM
formulation": the heavier fluid lies on top and falls through the lighter one, until both are almost at rest, the other
way round. The pressure at the end is compared with that of the inverted layers at rest, see demos/validation/layers.

    python demos/layer_inversion.py --spacing 0.005
"""

import math

import numpy as np
from tipfem.demos import harness
from tipfem.demos.support.options import Positive, Rule
from tipfem.demos.validation.layers.check import LayersTurnOver

import tipfem as tp

EDGE = 0.1  # of the tank [m]


def case(spacing: Positive = 0.002, interface: Rule = "interpolated") -> tp.Case:
    """Each fluid fills half of a square tank; the interface starts as a wave: layers in balance would stay.

    Args:
        spacing: distance between particles [m].
        interface: rule for the interface; interpolated is the paper's, the sharp one leaves films on walls at 5 mm.
    """
    glycerin = tp.Fluid("glycerin", density=1261.0, viscosity=1.412)  # both at 20 degrees Celsius
    water = tp.Fluid("water", density=998.2, viscosity=1.002e-3)
    tank = tp.tank(size=(EDGE, EDGE), spacing=spacing)
    tank.fill(water)
    x = np.linspace(0, EDGE, 201)
    wave = np.column_stack([x, EDGE / 2 + 0.005 * np.cos(2 * np.pi * x / EDGE)])
    tank.fill(glycerin, shape=[*wave, (EDGE, EDGE), (0, EDGE)])
    for side in ("left", "right", "bottom", "top"):
        tank.wall(side, law="no-slip")  # the glycerin's layer is thick, and it has to run off the walls
    return tp.Case(
        tank,
        fluids=[glycerin, water],
        gravity=(0, -9.81),
        interface=interface,
        # Volumes are corrected twice as fast as by default: every remeshing changes them while the interface is torn.
        numerics=tp.Numerics(volume_correction=2.0),
        title="Glycerin above water",
    )


# Runs the case, compares it with hydrostatics and draws it. Without the harness:
#     tp.init()
#     tp.Simulation(case(), out="out/layer_inversion", time_step=0.01, output_interval=0.25).run(40.75)
main = harness.Demo(
    case,
    end_time=40.75,  # that of the paper [s]
    time_step=0.01,  # the largest; it adapts below [s]
    frames_per_second=4.0,  # of simulated time
    check=lambda case: LayersTurnOver(*case.fluids, EDGE),
    strip=(0.0, 0.5, 1.0, 1.5, 2.0, 4.0, 10.0, math.inf),
)

if __name__ == "__main__":
    harness.command(__name__)
