"""Clouds of particles nobody would make by hand: each is meshed without a gap, or refused by one clear error."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import tipfem as tp

WATER = tp.Fluid("water", 998.2, 1.002e-3)

clouds = st.fixed_dictionaries(
    {
        "seed": st.integers(0, 2**16),
        "shape": st.tuples(st.integers(3, 12), st.integers(3, 12)),
        "scale": st.sampled_from([1e-6, 1e-3, 1.0, 1e3]),
        "stretch": st.sampled_from([1.0, 1.0, 3.0, 1e3, 1e-9, 0.0]),
        "offset": st.sampled_from([0.0, 0.0, -0.5, 1e3, 1e6, 1e12]),
        "jitter": st.sampled_from([0.0, 0.1, 0.3]),
        "damage": st.sampled_from(["", "", "duplicate", "near duplicate", "swapped corner", "nan", "far"]),
        "interface": st.sampled_from(["sharp", "interpolated"]),
    }
)


def cloud(seed, shape, scale, stretch, offset, jitter, damage):
    """Positions (N, 2), walls (N,) and the area of the box they fill."""
    rng = np.random.default_rng(seed)
    x = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1).reshape(-1, 2).astype(float)
    wall = ((x == 0) | (x == np.array(shape) - 1)).any(axis=1)
    x[~wall] += rng.uniform(-jitter, jitter, (int((~wall).sum()), 2))
    inside = np.flatnonzero(~wall)
    if damage == "duplicate":
        x[inside[0]] = x[0]
    elif damage == "near duplicate":
        x[inside[0]] = x[inside[-1]] + 1e-9
    elif damage == "swapped corner":
        wall[0] = False
    elif damage == "nan":
        x[inside[0]] = np.nan
    elif damage == "far":
        x[inside[0]] = 1e6
    order = rng.permutation(len(x))
    x = x[order] * scale * np.array([1.0, stretch])
    return x + offset * scale, wall[order], float(np.prod(np.array(shape) - 1)) * scale**2 * stretch


@pytest.mark.slow
@given(clouds)
@settings(max_examples=150, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
def test_a_cloud_is_meshed_without_a_gap_or_refused(settings_of):
    interface = settings_of.pop("interface")
    position, wall, area = cloud(**settings_of)
    try:
        particles = tp.Particles(position, np.zeros(len(position), int), wall)
        case = tp.Case(particles, [WATER], (0, -9.81), interface=interface)
        mesh = tp.Simulation(case).mesh
    except ValueError as error:
        refused = str(error)
        assert refused.startswith(("Particles: ", "Case: ", "Simulation: "))
        return
    assert mesh.measure.sum() == pytest.approx(area, rel=1e-6)
    assert (mesh.measure > 0).all()
    assert sorted(set(mesh.cells.ravel())) == list(range(len(position)))
