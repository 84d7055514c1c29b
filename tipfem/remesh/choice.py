"""The remesher of a case, by its interface rule and its dimension; nothing else uses the name of the rule."""

from __future__ import annotations

from tipfem.case.case import Case
from tipfem.remesh.cavity_remesher import CavityRemesher
from tipfem.remesh.remeshers import DelaunayRemesher, FittedRemesher, Remesher
from tipfem.remesh.repair_account import RepairAccount

REMESHERS: dict[str, type[DelaunayRemesher] | type[FittedRemesher]] = {
    "interpolated": DelaunayRemesher,
    "sharp": FittedRemesher,
}


def remesher_for(case: Case) -> Remesher:
    """The remesher of a case."""
    in_rounds = case.interface == "sharp" and case.particles.dimension == 3
    remesher: Remesher = CavityRemesher.of(case) if in_rounds else REMESHERS[case.interface].of(case)
    if case.numerics.budget == "detailed":
        remesher.account = RepairAccount(case, remesher.repairs)
    return remesher
