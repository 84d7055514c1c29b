"""Evenly spaced streamlines.

Lines keep a distance from each other and end before they wind around themselves, after B. Jobard and W. Lefer,
Creating evenly-spaced streamlines of arbitrary density, Visualization in Scientific Computing '97, Springer, 1997. All
candidates are integrated at once from the points of a grid; then one after the other, those that would be longest
first, is kept as far as it stays away from the lines before it.
"""

import numpy as np

from .arrays import Array
from .flow import VelocityGrid
from .scene import Scene

_STEPS = 160  # of a streamline in either direction
_A_STEP = 0.25  # of the distance between lines, like the lengths below
_SEEDS = 0.75  # between the seeds of candidates
_NEAREST = 0.5  # that a line comes to another one, or to itself
_SHORTEST = 1.5  # line that is kept
_SMALLEST = 0.8  # extent of a line that is kept: a smaller ring would look like a bubble
_PIXELS = 8  # of the masks of what is taken, to the distance between lines


def streamlines(scene: Scene, lower: Array, upper: Array, apart: float) -> list[Array]:
    """Streamlines, each (K, 2) [m] in the direction of the flow, about ``apart`` [m]; closed ones end where they began.

    Lines between two corners (2,) [m] are integrated with steps of equal length by the midpoint rule, and end where the
    fluids end, where the flow rests, or at half the distance between lines from another line or from an earlier part of
    their own.
    """
    field = VelocityGrid(scene, lower, upper, scene.spacing / 2)
    slow = 0.01 * float(np.linalg.norm(field.values, axis=2).max(initial=0.0))
    if slow == 0:
        return []
    behind, ahead = _candidates(field, lower, upper, apart, slow)
    lengths = np.isfinite(behind[..., 0]).sum(axis=1) + np.isfinite(ahead[..., 0]).sum(axis=1)
    order = np.random.default_rng(0).permutation(len(ahead))
    # Lines of about equal length are taken in random order.
    order = order[np.argsort(-(lengths[order] // (_STEPS // 8)), kind="stable")]
    taken = _Taken(lower, upper, apart)
    lines = []
    for k in order:
        if lengths[k] < 3 or taken.seed(ahead[k, 0]):
            continue
        line = _trimmed(behind[k], ahead[k], taken, apart)
        long = (len(line) - 1) * _A_STEP >= _SHORTEST
        if long and float(np.ptp(line, axis=0).max()) >= _SMALLEST * apart:
            lines.append(line)
            taken.add(line)
    return lines


class _Taken:
    """Masks of the points too near to earlier lines, for seeds and for lines."""

    def __init__(self, lower: Array, upper: Array, apart: float) -> None:
        self._lower, self._step = lower, apart / _PIXELS
        columns, rows = (int(np.ceil(length / self._step)) + 1 for length in upper - lower)
        self._masks = np.zeros((2, rows, columns), bool)
        reach = np.arange(-_PIXELS, _PIXELS + 1)
        i, j = (values.ravel() for values in np.meshgrid(reach, reach))
        distance = np.hypot(i, j) / _PIXELS
        self._discs = [np.stack([i, j], axis=1)[distance < limit] for limit in (1.0, _NEAREST)]

    def seed(self, point: Array) -> bool:
        """Whether a point (2,) is too near to a line to begin another one."""
        return bool(self._of(0, point[None])[0])

    def near(self, points: Array) -> Array:
        """Whether points (P, 2) are too near to a line to go on, (P,) bool."""
        return self._of(1, points)

    def add(self, line: Array) -> None:
        """Take the surroundings of a line (K, 2)."""
        at = self._indices(line)
        rows, columns = self._masks.shape[1:]
        for mask, disc in zip(self._masks, self._discs, strict=True):
            i, j = (at[:, None] + disc).reshape(-1, 2).T
            inside = (i >= 0) & (i < columns) & (j >= 0) & (j < rows)
            mask[j[inside], i[inside]] = True

    def _indices(self, points: Array) -> Array:
        return np.asarray(np.rint((points - self._lower) / self._step).astype(int))

    def _of(self, which: int, points: Array) -> Array:
        rows, columns = self._masks.shape[1:]
        i, j = self._indices(points).T
        return np.asarray(self._masks[which, np.clip(j, 0, rows - 1), np.clip(i, 0, columns - 1)])


def _candidates(field: VelocityGrid, lower: Array, upper: Array, apart: float, slow: float) -> list[Array]:
    """Paths (S, K, 2) against the flow and along it from the points of a grid; NaN beyond their ends."""
    columns, rows = (max(1, int(length / (_SEEDS * apart))) for length in upper - lower)
    i, j = np.meshgrid(np.arange(columns), np.arange(rows))
    seeds = lower + (np.stack([i.ravel(), j.ravel()], axis=1) + 0.5) * (upper - lower) / [columns, rows]
    step, paths = _A_STEP * apart, []
    for sign in (-1.0, 1.0):
        path = np.full((len(seeds), _STEPS + 1, 2), np.nan)
        going, at = np.arange(len(seeds)), seeds
        path[:, 0] = seeds
        for k in range(1, _STEPS + 1):
            there, _ = _direction(field, at, slow)
            onward, moving = _direction(field, at + sign * step / 2 * there, slow)
            going, at = going[moving], (at + sign * step * onward)[moving]
            if len(going) == 0:
                break
            path[going, k] = at
        paths.append(path)
    return paths


def _direction(field: VelocityGrid, points: Array, slow: float) -> tuple[Array, Array]:
    """Unit vectors (P, 2) along the velocity, and whether the points are in a moving fluid, (P,) bool."""
    values, inside = field(points)
    speed = np.linalg.norm(values, axis=1)
    return values / np.maximum(speed, slow)[:, None], inside & (speed > slow)


def _trimmed(behind: Array, ahead: Array, taken: _Taken, apart: float) -> Array:
    """The line (K, 2) of the paths (K, 2) against the flow and along it, up to where other lines or itself are near."""
    forward = _until(ahead, taken)
    stop, closed = _self_approach(forward, apart)
    forward = forward[:stop]
    if closed:
        return np.concatenate([forward, forward[:1]])
    line = np.concatenate([forward[::-1], _until(behind, taken)[1:]])  # against the flow
    stop, _ = _self_approach(line, apart, first=len(forward))
    return line[:stop][::-1]


def _until(path: Array, taken: _Taken) -> Array:
    """The part of a path that is finite and not near an earlier line; its first point at least."""
    end = np.isnan(path[:, 0])
    path = path[: int(np.argmax(end)) if end.any() else len(path)]
    near = taken.near(path)
    near[0] = False
    return path[: int(np.argmax(near)) if near.any() else len(path)]


def _self_approach(line: Array, apart: float, first: int = 1) -> tuple[int, bool]:
    """Number of points to keep of a line (K, 2) before it comes near itself, and whether it closes there.

    Points are at equal steps, lines ``apart`` [m]; those before ``first`` are known to keep their distance.
    """
    gap = np.linalg.norm(line[:, None] - line[None], axis=2)
    number = np.arange(len(line))
    # The arc between two points of a line that has turned back is longer than the distance between them.
    apart_along = (number[:, None] - number[None]) * _A_STEP > 3 * _NEAREST
    near = (apart_along & (gap < _NEAREST * apart)).any(axis=1)
    near[:first] = False
    if not near.any():
        return len(line), False
    stop = int(np.argmax(near))
    after = slice(stop, stop + int(2 * _NEAREST / _A_STEP) + 2)
    back = gap[after, 0]
    if back.min() < 0.6 * _A_STEP * apart:  # the steps pass the first point by at most half of one
        return stop + int(np.argmin(back)), True
    return stop, False
