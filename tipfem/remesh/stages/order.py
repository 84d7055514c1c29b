"""The stages of a remeshing in their order."""

from tipfem.remesh.stages.balances import energy_kept, handed_over, momentum_kept
from tipfem.remesh.stages.empty_space import (
    pieces_keep_momentum,
    spray_kept_in_tank,
    spray_labelled,
    with_empty_space,
    without_empty_space,
)
from tipfem.remesh.stages.in_space import (
    booked,
    kept_in_tank,
    momentum_restored,
    placed,
    renumbered_on_walls,
    taken_over,
    volumes_restored,
    with_empty_cells,
    with_landed_spray,
    with_small_pieces_released,
    with_sound_cells,
)
from tipfem.remesh.stages.motion import left_by_physics, set_back, with_targets
from tipfem.remesh.stages.next_state import carried_along, labelled, led_by_walls, weighed
from tipfem.remesh.stages.repairing import repaired

# From the end of a step to all of the next state but what follows from it.
STAGES = (
    set_back,
    spray_kept_in_tank,
    left_by_physics,
    with_targets,
    with_empty_space,
    repaired,
    without_empty_space,
    labelled,
    spray_labelled,
    carried_along,
    led_by_walls,
    weighed,
    pieces_keep_momentum,
    momentum_kept,
    energy_kept,
    handed_over,
)

# The same in 3-D.
STAGES_IN_SPACE = (
    placed,
    kept_in_tank,
    with_empty_cells,
    with_landed_spray,
    with_sound_cells,
    volumes_restored,
    momentum_restored,
    with_small_pieces_released,
    taken_over,
    carried_along,
    renumbered_on_walls,
    weighed,
    booked,
)
