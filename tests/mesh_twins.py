"""NumPy and SciPy twins of sums and graphs that the solver computes by kernels."""

import numpy as np
from scipy import sparse

from tipfem.case.particles import Particles
from tipfem.mesh.measures import Energy
from tipfem.mesh.mesh import Mesh


def fluid_volumes(mesh: Mesh, fraction: np.ndarray) -> np.ndarray:
    """Volume of each of F fluids (F,), from their fractions of the cells (M, F)."""
    return mesh.measure @ fraction


def nodal_mass(mesh: Mesh, density: np.ndarray) -> np.ndarray:
    """Lumped mass (N,) [kg] from the elements' densities (M,)."""
    corners = mesh.cells.shape[1]
    share = np.repeat(density * mesh.measure / corners, corners)
    return np.bincount(mesh.cells.ravel(), weights=share, minlength=len(mesh.position))


def energy(mesh: Mesh, particles: Particles, density: np.ndarray, gravity: np.ndarray) -> Energy:
    """Kinetic and potential energy with lumped masses; the potential is zero at the origin."""
    mass = nodal_mass(mesh, density)
    kinetic = 0.5 * float(mass @ (particles.velocity**2).sum(axis=1))
    return Energy(kinetic, -float(mass @ (particles.position @ gravity)))


def adjacency(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Particles that share a cell with each particle, itself included, in CSR (offsets, columns)."""
    n, (m, corners) = len(mesh.position), mesh.cells.shape
    starts = np.arange(0, m * corners + 1, corners)
    member = sparse.csr_matrix((np.ones(m * corners, np.int32), mesh.cells.ravel(), starts), shape=(m, n))
    graph = (member.T @ member).tocsr()
    graph.sort_indices()
    return graph.indptr.astype(np.int32), graph.indices.astype(np.int32)
