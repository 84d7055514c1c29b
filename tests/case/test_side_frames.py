"""Pseudo-inverses of the normals of the sides that a particle lies on."""

import numpy as np
import pytest

from tipfem.case.boundary.side_frames import inverses


@pytest.mark.parametrize("d", [2, 3])
def test_inverses_are_those_of_numpy(d):
    """Of no side, of one, and of two."""
    normal = np.random.default_rng(d).normal(size=(30, d, d))
    normal /= np.linalg.norm(normal, axis=2)[:, :, None]
    normal[:10], normal[10:20, 1:] = 0.0, 0.0
    np.testing.assert_allclose(inverses(normal), np.linalg.pinv(normal, rcond=1e-9), atol=1e-12, rtol=1e-9)
