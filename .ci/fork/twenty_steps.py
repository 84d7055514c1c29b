"""Twenty steps of a dam break on one thread: a hash of positions, velocities and pressures."""

import hashlib

import tipfem as tp

tp.init(threads=1)
water, air = tp.Fluid("water", 998.2, 1.002e-3), tp.Fluid("air", 1.204, 1.825e-5)
tank = tp.tank((0.584, 0.584), 0.04).fill(air).fill(water, box=((0, 0), (0.146, 0.292)))
simulation = tp.Simulation(tp.Case(tank, [water, air], gravity=(0, -9.81)), time_step=6e-3)
for _ in range(20):
    simulation.step()
state = simulation.particles
print(hashlib.sha256(b"".join(f.tobytes() for f in (state.position, state.velocity, state.pressure))).hexdigest()[:16])
