"""Bundles of arrays that the element kernels take, see `tipfem.backend.bundles`."""

from typing import NamedTuple

from tipfem.backend.array_types import Ints1, Ints2, Reals1, Reals2, Template


class Topology(NamedTuple):
    """Cells, and in CSR the cells of each node (see `sparsity.list_corners`)."""

    cells: "Ints2"  # (M, d + 1)
    offsets: "Ints1"  # (P + 1,)
    corners: "Ints1"  # (M (d + 1),)


class Elements(NamedTuple):
    """Properties of the M elements in a step."""

    density: "Reals1"  # (M,)
    viscosity: "Reals1"  # (M,); of a law, that at the step's start, which the stabilisation keeps
    source: "Reals1"  # (M,) prescribed growth of the volume, s in J - 1 = s
    lumping: "Reals1"  # (M,) part lambda of the mass matrix that is lumped, see `tipfem.fem.mass`
    fluid: "Ints1"  # (M,) where viscosity follows laws, else (1,), as all laws
    laws: "Reals2"  # (F, 8), see `tipfem.fem.rheology`
    lawful: "Template"  # whether viscosity follows laws


class Linearisation(NamedTuple):
    """Results of `residual.residual` on the elements."""

    record: "Reals2"  # (M, `residual.record_width`) their linearisation
    local: "Reals2"  # (M (d + 1), d + 1) their vectors, corner by corner


class Iterate(NamedTuple):
    """Unknowns at which the residual is taken, and the iterate whose correction has led there."""

    x: "Reals1"
    base: "int"  # place of that iterate in the elements' records, 0 or 1; -1 for none; see `tipfem.fem.rheology`


class Rates(NamedTuple):
    """Derivatives of the rates by the step's displacements, see `TimeScheme`, and the step's length."""

    cm: "float"  # of a_alpha [1/s^2]
    cv: "float"  # of v_alpha [1/s]
    cf: "float"  # of x_alpha
    dt: "float"  # [s]


class Sizes(NamedTuple):
    """Sizes of a mesh."""

    elements: "int"
    nodes: "int"
    dim: "Template"
