"""Images of the cells at periodic sides, so that a picture shows a whole period with straight ends."""

import numpy as np

from tipfem.results.fields.gradients import SAME_PLACE, first_of_each, wrapped

from .arrays import Array


def with_images(position: Array, cells: Array, period: Array, spacing: float) -> tuple[Array, Array, Array, Array]:
    """A mesh that covers a whole period, from one whose cells reach across its periodic sides.

    Every cell has its middle in 0 <= x < period, and the cells that stick out of it are there once more at the other
    end. Neighbours share their particles also across the sides. Cells are narrower than half a period; copies of a
    particle a period away count as the same one.

    Returns:
        Positions (P, 2) of the particles and their images [m]; cells (C, 3), C >= M; and the numbers (P,) and (C,) of
        the particle and the cell that each is an image of.
    """
    axes = np.flatnonzero(period > 0)
    home = wrapped(position, period)
    first = first_of_each(home, period, SAME_PLACE * spacing)

    corner = first[cells]
    offset = home[corner] - home[corner[:, :1]]
    image = np.zeros(offset.shape, np.int64)
    image[:, :, axes] = -np.round(offset[:, :, axes] / period[axes]).astype(np.int64)
    middle = (home[corner] + image * period).mean(axis=1)
    image[:, :, axes] -= np.floor(middle[:, axes] / period[axes]).astype(np.int64)[:, None]

    cell = np.arange(len(cells))
    for k in axes:
        x = home[corner, k] + image[:, :, k] * period[k]
        slack = SAME_PLACE * spacing
        low, high = (x < -slack).any(axis=1), (x > period[k] + slack).any(axis=1)
        step = np.zeros(2, np.int64)
        step[k] = 1
        image = np.concatenate([image, image[low] + step, image[high] - step])
        corner, cell = (np.concatenate([a, a[low], a[high]]) for a in (corner, cell))

    kept = np.flatnonzero(first == np.arange(len(position)))
    number = np.full(len(position), -1)
    number[kept] = np.arange(len(kept))
    away = image.any(axis=2)
    copies, inverse = np.unique(np.column_stack([corner[away], image[away]]), axis=0, return_inverse=True)
    nodes = number[corner]
    nodes[away] = len(kept) + inverse.ravel()
    particle = np.concatenate([kept, copies[:, 0]])
    place = np.concatenate([home[kept], home[copies[:, 0]] + copies[:, 1:] * period])
    return place, nodes, particle, cell
