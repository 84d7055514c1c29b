"""A plain twin of the rasteriser: every sample of every triangle in its box is tested, in Python's integers."""

import numpy as np


def paint(vertices, colours, background, size, samples=2):
    """Picture (H, W, 3) uint8 of triangles (T, 3, 2) [px] with colours (T, 3, 3) at their vertices."""
    width, height = size
    picture = np.empty((height * samples, width * samples, 3))
    picture[:] = background
    snapped = np.rint(np.asarray(vertices, np.float32).astype(float) * samples * 256).astype(np.int64)
    for corners, points, shades in zip(snapped, np.asarray(vertices, float), np.asarray(colours, float), strict=True):
        (ax, ay), (bx, by), (cx, cy) = corners.tolist()
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0:
            continue
        columns = np.arange(max(0, min(ax, bx, cx) // 256 - 1), min(width * samples, max(ax, bx, cx) // 256 + 2))
        rows = np.arange(max(0, min(ay, by, cy) // 256 - 1), min(height * samples, max(ay, by, cy) // 256 + 2))
        if not (len(columns) and len(rows)):
            continue
        x, y = np.meshgrid(columns * 256 + 128, rows * 256 + 128)
        inside = np.ones(x.shape, bool)
        for (px, py), (qx, qy) in (((ax, ay), (bx, by)), ((bx, by), (cx, cy)), ((cx, cy), (ax, ay))):
            inside &= ((qx - px) * (y - py) - (qy - py) * (x - px)) * np.sign(area) >= 0
        # Colours are linear between the vertices; samples just outside take the nearest inside.
        sides = (points[1:] - points[0]).T
        v, w = np.zeros(x.shape), np.zeros(x.shape)
        if abs(np.linalg.det(sides)) > 0:
            at = np.stack([(x / 256) / samples, (y / 256) / samples], axis=-1) - points[0]
            v, w = np.moveaxis(at @ np.linalg.inv(sides).T, -1, 0)
            v = np.clip(v, 0, 1)
            w = np.clip(w, 0, 1 - v)
        mixed = shades[0] + v[..., None] * (shades[1] - shades[0]) + w[..., None] * (shades[2] - shades[0])
        part = picture[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        part[inside] = mixed[inside]
    means = picture.reshape(height, samples, width, samples, 3).mean(axis=(1, 3))
    return np.clip(means * 255 + 0.5, 0, 255).astype(np.uint8)
