"""Small cases that together need all common kernels, for `tipfem compile`."""

from __future__ import annotations

from collections.abc import Iterator

import tipfem as tp


def cases() -> Iterator[tp.Case]:
    """A small case for each kind of kernel: fluids, interfaces, walls, bodies, openings, axes."""
    water, air = tp.Fluid("water", 998.2, 1.002e-3), tp.Fluid("air", 1.204, 1.825e-5)
    oil, gravity, size, spacing = tp.Fluid("oil", 800.0, 5e-3), (0.0, -9.81), (0.584, 0.584), 0.03
    column, pool = ((0.0, 0.0), (0.146, 0.292)), ((0.0, 0.0), (0.584, 0.292))
    both = [water, air]

    def tank(other: tp.Fluid | None = air, box: object = column, **options: object) -> tp.Tank:
        made = tp.tank(size, spacing, **options)  # type: ignore[arg-type]
        return (made.fill(other) if other else made).fill(water, box=box)  # type: ignore[arg-type]

    def circle() -> tp.Body:
        return tp.Body(tp.shapes.circle((0.3, 0.3), 0.1), density=300.0, angular_velocity=3.0)

    yield tp.Case(tank(), both, gravity)
    yield tp.Case(tank(), both, gravity, grading=tp.Grading({"air": 0.12}))
    # So fast that the control of long steps measures how they would deform the elements.
    fast = tp.tank(size, spacing).fill(air).fill(water, box=column, velocity=(4.0, 0.0))
    yield tp.Case(fast, both, gravity, numerics=tp.Numerics(largest_move=0.8))
    yield tp.Case(tank(), both, gravity, interface="interpolated")
    yield tp.Case(tank(box=pool, periodic="x"), both, gravity)
    yield tp.Case(tank(), both, gravity, surface_tension={("water", "air"): 20.0})
    yield tp.Case(tank(oil, pool), [water, oil], (6.0, -9.81))
    yield tp.Case(tank(None), [water], gravity, free_surface=True)
    yield tp.Case(tank(box=pool).add(circle()), both, gravity)
    yield tp.Case(tank(None, pool).add(circle()), [water], gravity, free_surface=True)
    inlet = tp.Inlet(wall="bottom", between=((0.3, 0), (0.5, 0)), fluid=water, velocity=0.5)
    vent = tp.Vent(wall="top", between=((0.1, 0.584), (0.3, 0.584)))
    yield tp.Case(tank(), both, gravity, openings=[inlet, vent])
    room = tp.tank((0.4, 0.2, 0.4), 0.06, jitter=0.2).fill(air).fill(water, box=((0, 0, 0), (0.146, 0.2, 0.25)))
    yield tp.Case(room, both, (0, 0, -9.81), interface="interpolated")
