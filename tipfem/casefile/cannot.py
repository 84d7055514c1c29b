"""Words for what tipfem does not have, which users of other programs try as keys or names."""

from __future__ import annotations

from collections.abc import Mapping

# Keys that users of other programs try, and what there is to say of them; docs/howto/cannot.md has more.
CANNOT = {
    "source sources sink sinks mass_source": "nothing makes or takes fluid within a tank; inlets and outlets "
    "in its walls do",
    "turbulence turbulence_model k_epsilon k_omega rans": "there is no model of turbulence but an eddy viscosity, "
    "viscosity = { law = 'smagorinsky', viscosity = 1e-3 }",
    "temperature heat thermal conductivity buoyancy boiling phase_change evaporation": "there is no heat",
    "stl obj iges cad geometry": "there are boxes, plane outlines (tank.shape), plane meshes of Gmsh (tank.mesh) and "
    "convex surfaces of STL (the table tank)",
    "gate gates valve valves door doors": "no wall opens within a tank; begin with the fluids as the "
    "gate leaves them, or let a whole side move away",
    "compressible sound_speed speed_of_sound bulk_modulus equation_of_state cavitation": "all fluids are "
    "incompressible",
    "elastic youngs_modulus young poisson_ratio structure deformable": "bodies are rigid",
    "porous porosity permeability": "there are no porous media",
    "adaptive refinement amr": "the spacing is that of the tank, graded by the table grading; refine there",
}


def cannot(word: str) -> str:
    """Remark on a word for something that tipfem does not have; empty for other words."""
    why = remark(CANNOT, word)
    return f"is not in tipfem: {why}; see the page 'What it cannot do' of the documentation" if why else ""


def remark(table: Mapping[str, str], word: str) -> str:
    """Remark on a word in a table with several words a key; empty if it is not there."""
    known = word.lower().replace("-", "_")
    return next((text for words, text in table.items() if known in words.split()), "")
