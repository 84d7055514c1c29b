"""The method's formulas once more, in plain NumPy: what the kernels are compared with.

Written from the formulas, not from the kernels: dense, with whole tensors and no shortcuts. All of
it also takes complex arrays, so that derivatives follow from a complex step to round-off.

Symbols: G_a reference gradients (M, d + 1, d), A reference measures (M,), F = sum_a x_alpha,a (x) G_a,
g_a = F^-T G_a, J = det F; alpha: generalized-alpha's intermediate values.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import sparse


@dataclass(frozen=True)
class Alpha:
    """Generalized-alpha's numbers for a spectral radius ``rho_inf`` and a time step ``dt`` [s]."""

    rho_inf: float
    dt: float

    @property
    def m(self):
        return (2 * self.rho_inf - 1) / (self.rho_inf + 1)

    @property
    def f(self):
        return self.rho_inf / (self.rho_inf + 1)

    @property
    def gamma(self):
        return 0.5 - self.m + self.f

    @property
    def beta(self):
        return (1 - self.m + self.f) ** 2 / 4

    def next_values(self, u, v, a):
        """v_{n+1} and a_{n+1} from displacements, old velocities and old accelerations."""
        a_next = u / (self.beta * self.dt**2) - v / (self.beta * self.dt) - (1 / (2 * self.beta) - 1) * a
        return v + self.dt * ((1 - self.gamma) * a + self.gamma * a_next), a_next

    def intermediate(self, u, v, a):
        """v_alpha and a_alpha."""
        v_next, a_next = self.next_values(u, v, a)
        return (1 - self.f) * v_next + self.f * v, (1 - self.m) * a_next + self.m * a


@dataclass(frozen=True)
class Step:
    """All that one time step's residual depends on besides the unknowns u (N, d) and p (N,).

    position, velocity, acceleration, body_force (N, d); cells (M, d + 1); wall (N,);
    density, viscosity, source (M,); stabilisation is c in tau = c dt^2; consistent is the part of the mass matrix
    that is int rho phi_a phi_b, the rest is lumped.
    """

    position: np.ndarray
    cells: np.ndarray
    wall: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    body_force: np.ndarray
    density: np.ndarray
    viscosity: np.ndarray
    source: np.ndarray
    alpha: Alpha
    stabilisation: float
    spacing: float
    consistent: float = 0.0

    @property
    def dimension(self):
        return self.position.shape[1]


def reference_gradients(position, cells):
    """G (M, d + 1, d) and A (M,): rows of the inverse of [1 x] at the corners."""
    d = position.shape[1]
    corners = position[cells]
    ones = np.concatenate([np.ones((*cells.shape, 1)), corners], axis=2)
    coefficients = np.linalg.inv(ones)  # column a: phi_a = c_0 + c_1 x + ...
    return np.swapaxes(coefficients[:, 1:, :], 1, 2), np.linalg.det(ones) / math.factorial(d)


def tau(step, area):
    """(M,) dt / sqrt((1 / (c dt))^2 + (12 nu / h^2)^2) [s^2], h the diameter of the circle (ball) of that area."""
    if step.dimension == 2:
        h = 2 * np.sqrt(area / np.pi)
    else:
        h = 2 * (3 * area / (4 * np.pi)) ** (1 / 3)
    dt = step.alpha.dt
    return dt / np.hypot(1 / (step.stabilisation * dt), 12 * step.viscosity / step.density / h**2)


def gather(values, cells, count):
    """Sum element vectors (M, d + 1, ...) into the nodes (N, ...)."""
    total = np.zeros((count, *values.shape[2:]), values.dtype)
    np.add.at(total, cells, values)
    return total


def parts(step, u, p):
    """The residual's terms, each (M, d + 1, d) or (M, d + 1): stress, inertia; volume, stabilisation."""
    d, cells = step.dimension, step.cells
    big_g, area = reference_gradients(step.position, cells)
    v_alpha, a_alpha = step.alpha.intermediate(u, step.velocity, step.acceleration)
    x_alpha, x_next = step.position + (1 - step.alpha.f) * u, step.position + u
    f = np.einsum("mai,maj->mij", x_alpha[cells], big_g)
    j_next = np.linalg.det(np.einsum("mai,maj->mij", x_next[cells], big_g))
    f_inverse, jacobian = np.linalg.inv(f), np.linalg.det(f)
    g = np.einsum("mji,maj->mai", f_inverse, big_g)
    l = np.einsum("mai,maj->mij", v_alpha[cells], g)
    strain_rate = (l + np.swapaxes(l, 1, 2)) / 2
    mean_p = p[cells].mean(axis=1)
    sigma = 2 * step.viscosity[:, None, None] * strain_rate - mean_p[:, None, None] * np.eye(d)
    stress = (area * jacobian)[:, None, None] * np.einsum("mij,maj->mai", sigma, g)
    relative = (a_alpha - step.body_force)[cells]
    # int phi_a phi_b = A d! / (d + 2)! (1 + delta_ab), times the d! in A
    shared = (relative + relative.sum(axis=1, keepdims=True)) / ((d + 1) * (d + 2))
    shared = step.consistent * shared + (1 - step.consistent) * relative / (d + 1)
    inertia = (area * step.density)[:, None, None] * shared
    volume = np.repeat((area * (j_next - 1 - step.source) / (d + 1))[:, None], d + 1, axis=1)
    q = relative.mean(axis=1) + (jacobian / step.density)[:, None] * np.einsum("ma,mai->mi", p[cells], g)
    stabilisation = (area * tau(step, area))[:, None] * np.einsum("mai,mi->ma", g, q)
    return stress, inertia, volume, stabilisation


def residual(step, u, p):
    """Momentum and continuity residual (N, d + 1), not scaled, and the sum of its terms' absolute values."""
    stress, inertia, volume, stabilisation = parts(step, u, p)
    n = len(step.position)
    rows = np.concatenate(
        [gather(stress + inertia, step.cells, n), gather(volume + stabilisation, step.cells, n)[:, None]], axis=1
    )
    size = np.concatenate(
        [
            gather(abs(stress) + abs(inertia), step.cells, n),
            gather(abs(volume) + abs(stabilisation), step.cells, n)[:, None],
        ],
        axis=1,
    )
    return rows, size


def jacobian_product(step, u, p, du, dp):
    """Derivative of `residual` along (du, dp) by a complex step: exact to round-off."""
    tiny = 1e-30
    return residual(step, u + 1j * tiny * du, p + 1j * tiny * dp)[0].imag / tiny


def row_scale(step):
    """1 / diag(A) in the momentum rows at u = 0, h / V_a in the continuity rows; 0 where u is fixed; (N, d + 1)."""
    d, n = step.dimension, len(step.position)
    big_g, area = reference_gradients(step.position, step.cells)
    cm = (1 - step.alpha.m) / (step.alpha.beta * step.alpha.dt**2)
    cv = (1 - step.alpha.f) * step.alpha.gamma / (step.alpha.beta * step.alpha.dt)
    squares = big_g**2 + (big_g**2).sum(axis=2, keepdims=True)
    inertia, friction = step.density * area / (d + 1) * cm, step.viscosity * area * cv
    diagonal = inertia[:, None, None] + friction[:, None, None] * squares
    volume = gather(np.repeat((area / (d + 1))[:, None], d + 1, axis=1), step.cells, n)
    momentum = np.where(step.wall[:, None], 0.0, 1 / gather(diagonal, step.cells, n))
    return np.concatenate([momentum, (step.spacing / volume)[:, None]], axis=1)


def laplacian(position, cells, coefficient):
    """P1 stiffness matrix sum_e A k_e g_a . g_b in CSR, ``coefficient`` k (M,)."""
    big_g, area = reference_gradients(position, cells)
    values = np.einsum("m,mai,mbi->mab", area * coefficient, big_g, big_g)
    corners = cells.shape[1]
    rows, columns = np.repeat(cells, corners, axis=1), np.tile(cells, (1, corners))
    n = len(position)
    return sparse.csr_matrix((values.ravel(), (rows.ravel(), columns.ravel())), shape=(n, n))


def hats(points, shape):
    """Multilinear interpolation from a grid with nodes at the integers 0 ... shape - 1 to points (K, d), in CSR.

    Grid nodes are numbered row by row, the last axis fastest.
    """
    result = sparse.csr_matrix(np.ones((len(points), 1)))
    for axis, count in enumerate(shape):
        weights = np.maximum(0.0, 1.0 - abs(points[:, axis, None] - np.arange(count)))
        # product of each row of the one with each row of the other
        blocks = [result.multiply(weights[:, k, None]) for k in range(count)]
        stacked = sparse.hstack(blocks).tocsc()
        done = result.shape[1]
        order = np.arange(done * count).reshape(count, done).T.ravel()
        result = stacked[:, order].tocsr()
    return result
