"""A closed surface of a fluid as seen by a camera: depth, thickness and normals by pixel, smoothed, and light.

The depth of the front faces and the thickness of the fluid, the sum of the depths of back faces less those of front
faces, are painted in bands of rows like the triangles of `tipfem.render.rasterizer`; an edge belongs to one of its two
faces, so that none is counted twice. Depth and normals are smoothed by a separable bilateral filter, which keeps edges
(W. van der Laan, S. Green and M. Sainz, Screen space fluid rendering with curvature flow, I3D 2009). Light is reflected
by Schlick's approximation of Fresnel's law, refracted towards the walls behind, and absorbed along the thickness.
"""

from typing import NamedTuple

import numpy as np

from .arrays import Array
from .camera import Camera, Room
from .rasterizer import BAND, BOX, in_bands, snap
from .runtime import ensure_runtime, ti
from .surface import Surface

FAR = 1e30  # depth where there is nothing
THIN = 0.2  # of the light is kept by the thinnest fluid, so that it is seen
INDEX = 1.33  # of refraction
REACH = 0.35  # of the smoothing [spacings]
MOST_REACH = 8  # [samples]
BLOCK = 0.6  # of the edges' colour that blocks have
SAME = 2.0  # difference of depth at which smoothing ends [spacings]


class Seen(NamedTuple):
    """A surface in a picture of H x W samples."""

    depth: Array  # (H, W) of the front faces along the camera's axis [m], `FAR` where there are none
    thickness: Array  # (H, W) of the fluid along the camera's axis [m]
    normal: Array  # (H, W, 3) outwards at the front
    flat: Array  # (H, W) 1 where the front is a face along a wall


class Light(NamedTuple):
    """Colours (3,) of a picture, in [0, 1]."""

    ground: Array  # around the tank
    wall: Array  # of the walls behind the fluid
    line: Array  # of the lines on them
    sky: Array  # that the surface reflects from above
    horizon: Array  # that it reflects from the sides
    fluid: Array  # of the fluid
    clear: float  # depth of fluid that takes about two thirds of the light [m]


@ti.kernel
def _paint_depth(
    samples: ti.i32,
    snapped: ti.types.ndarray(dtype=ti.i32, ndim=2),
    start: ti.types.ndarray(dtype=ti.i32, ndim=1),
    listed: ti.types.ndarray(dtype=ti.i32, ndim=1),
    vertices: ti.types.ndarray(dtype=ti.f32, ndim=3),
    far: ti.types.ndarray(dtype=ti.f32, ndim=2),
    normals: ti.types.ndarray(dtype=ti.f32, ndim=3),
    along: ti.types.ndarray(dtype=ti.i32, ndim=1),
    depth: ti.types.ndarray(dtype=ti.f32, ndim=2),
    thickness: ti.types.ndarray(dtype=ti.f32, ndim=2),
    normal: ti.types.ndarray(dtype=ti.f32, ndim=3),
    flat: ti.types.ndarray(dtype=ti.i32, ndim=2),
):
    """Depth, thickness and normals of the samples, one thread per band; for `snapped` to `listed` see `rasterizer`.

    Args:
        vertices: (T, 3, 2) [px]; corners are turned round for back faces.
        far: (T, 3) their distances forwards [m].
        normals: (T, 3, 3) at the vertices.
        along: (T,) 1 for faces along walls.
        depth: (H, W), `FAR` at first.
        thickness: (H, W), 0 at first.
        normal, flat: (H, W, 3), (H, W), written where there is a front face.
    """
    ti.loop_config(block_dim=1)
    for b in range(start.shape[0] - 1):
        top = b * BAND * samples
        bottom = ti.min(top + BAND * samples, depth.shape[0]) - 1
        for k in range(start[b], start[b + 1]):
            t = listed[k]
            ax, ay = snapped[t, 0], snapped[t, 1]
            bx, by = snapped[t, 2], snapped[t, 3]
            cx, cy = snapped[t, 4], snapped[t, 5]
            # The order of the corners was turned round for one of the two windings.
            turned = bx != snap(vertices[t, 1, 0], samples) or by != snap(vertices[t, 1, 1], samples)
            second, third = 1, 2
            if turned:
                second, third = 2, 1
            za, zb, zc = 1 / far[t, 0], 1 / far[t, second], 1 / far[t, third]
            # An edge's samples belong to the face whose edge runs downwards, or to the left.
            ab = 0 if by > ay or (by == ay and bx < ax) else -1
            bc = 0 if cy > by or (cy == by and cx < bx) else -1
            ca = 0 if ay > cy or (ay == cy and ax < cx) else -1
            area = ti.cast(ti.i64(bx - ax) * ti.i64(cy - ay) - ti.i64(by - ay) * ti.i64(cx - ax), ti.f32)
            for y in range(ti.max(top, snapped[t, BOX + 2]), ti.min(bottom, snapped[t, BOX + 3]) + 1):
                py = y * 256 + 128
                for x in range(snapped[t, BOX], snapped[t, BOX + 1] + 1):
                    px = x * 256 + 128
                    u = ti.i64(bx - ax) * ti.i64(py - ay) - ti.i64(by - ay) * ti.i64(px - ax)
                    v = ti.i64(cx - bx) * ti.i64(py - by) - ti.i64(cy - by) * ti.i64(px - bx)
                    w = ti.i64(ax - cx) * ti.i64(py - cy) - ti.i64(ay - cy) * ti.i64(px - cx)
                    if u + ab >= 0 and v + bc >= 0 and w + ca >= 0:
                        # Inverse distances are linear in the picture.
                        pa, pb = ti.cast(v, ti.f32) / area * za, ti.cast(w, ti.f32) / area * zb
                        pc = ti.cast(u, ti.f32) / area * zc
                        z = 1 / (pa + pb + pc)
                        if turned:  # anticlockwise from outside is clockwise with y down: a front face
                            thickness[y, x] -= z
                            if z < depth[y, x]:
                                depth[y, x] = z
                                flat[y, x] = along[t]
                                for i in ti.static(range(3)):
                                    sum = pa * normals[t, 0, i] + pb * normals[t, second, i] + pc * normals[t, third, i]
                                    normal[y, x, i] = sum * z
                        else:
                            thickness[y, x] += z


@ti.kernel
def _smooth(
    depth: ti.types.ndarray(dtype=ti.f32, ndim=2),
    normal: ti.types.ndarray(dtype=ti.f32, ndim=3),
    flat: ti.types.ndarray(dtype=ti.i32, ndim=2),
    reach: ti.i32,
    same: ti.f32,
    across: ti.i32,
    new_depth: ti.types.ndarray(dtype=ti.f32, ndim=2),
    new_normal: ti.types.ndarray(dtype=ti.f32, ndim=3),
):
    """Smooth depth and normals off walls along one axis, rows or columns, each with those of nearly its depth.

    The filter has a ``reach`` [samples]; weights end at a difference of depth ``same`` [m].
    """
    for y in range(depth.shape[0]):
        for x in range(depth.shape[1]):
            z = depth[y, x]
            n = ti.Vector([normal[y, x, 0], normal[y, x, 1], normal[y, x, 2]])
            if z < FAR and flat[y, x] == 0:
                total, mean, turned = z * 0, z * 0, n * 0
                for k in range(-reach, reach + 1):
                    j = ti.math.clamp(y + k * (1 - across), 0, depth.shape[0] - 1)
                    i = ti.math.clamp(x + k * across, 0, depth.shape[1] - 1)
                    off = (depth[j, i] - z) / same
                    if flat[j, i] == 0 and ti.abs(off) < 1:
                        here, near = ti.cast(k, ti.f32) / (reach + 1), 1 - off * off
                        weight = (1 - here * here) * near * near
                        total += weight
                        mean += weight * depth[j, i]
                        turned += weight * ti.Vector([normal[j, i, 0], normal[j, i, 1], normal[j, i, 2]])
                z, n = mean / total, turned / total
            new_depth[y, x] = z
            for i in ti.static(range(3)):
                new_normal[y, x, i] = n[i]


@ti.func
def _walls(
    at,
    ray,
    light: ti.template(),
    planes: ti.template(),
    bases: ti.template(),
    view: ti.template(),
    step: ti.f32,
    before: ti.f32,
    focal: ti.f32,
) -> ti.types.vector(3, ti.f32):
    """Colour of the walls of the room where a ray leaves it, from a point before of the eye; the ground's outside."""
    first, last, plane = ti.cast(-FAR, ti.f32), ti.cast(FAR, ti.f32), -1
    for k in range(planes.shape[0]):
        n = ti.Vector([planes[k, 0], planes[k, 1], planes[k, 2]])
        rate, room = n.dot(ray), planes[k, 3] - n.dot(at)
        if rate > 1e-6:
            if room / rate < last:
                last, plane = room / rate, k
        elif rate < -1e-6:
            first = ti.max(first, room / rate)
        elif room < 0:
            first = ti.cast(FAR, ti.f32)
    out = ti.Vector([light[0, 0], light[0, 1], light[0, 2]])
    if plane >= 0 and first < last and last > -1e-3:
        width = (before + last) / focal  # of a pixel there [m]
        place = at + ray * last - ti.Vector([view[6, 0], view[6, 1], view[6, 2]])
        wall = ti.Vector([light[1, 0], light[1, 1], light[1, 2]])
        line = ti.Vector([light[2, 0], light[2, 1], light[2, 2]])
        share = ti.cast(0, ti.f32)
        for m in ti.static(range(2)):
            u = place.dot(ti.Vector([bases[plane, m, 0], bases[plane, m, 1], bases[plane, m, 2]])) / step
            apart = ti.abs(u - ti.floor(u + 0.5)) * step
            share = ti.max(share, ti.math.clamp(1.5 - apart / width, 0, 1))
        # Walls are lit from above: each has its own tone.
        tone = bases[plane, 2, 0]
        out = (wall + (line - wall) * share) * tone
        edge = ti.cast(FAR, ti.f32)
        for k in range(planes.shape[0]):  # the edges between walls behind the fluid
            if k != plane:
                n = ti.Vector([planes[k, 0], planes[k, 1], planes[k, 2]])
                edge = ti.min(edge, planes[k, 3] - n.dot(at + ray * last))
        dark = ti.math.clamp(2.5 - edge / width, 0, 1)
        out += (ti.Vector([light[6, 0], light[6, 1], light[6, 2]]) - out) * dark
    return out


@ti.func
def _block(at, ray, blocks: ti.template()) -> ti.types.vector(4, ti.f32):
    """Distance along a ray at which it meets a block, `FAR` for none, and the normal of the side there."""
    found = ti.Vector([ti.cast(FAR, ti.f32), ti.cast(0, ti.f32), ti.cast(0, ti.f32), ti.cast(0, ti.f32)])
    for b in range(blocks.shape[0]):
        corner = ti.Vector([blocks[b, 0, 0], blocks[b, 0, 1], blocks[b, 0, 2]]) - at
        first, last, side = ti.cast(0, ti.f32), ti.cast(FAR, ti.f32), ti.Vector([0.0, 0.0, 0.0])
        for k in ti.static(range(3)):
            edge = ti.Vector([blocks[b, k + 1, 0], blocks[b, k + 1, 1], blocks[b, k + 1, 2]])
            length = edge.norm()
            n = edge / length
            rate, near = n.dot(ray), n.dot(corner)
            far = near + length
            if rate < 0:
                near, far = far, near
            if ti.abs(rate) > 1e-9:
                if near / rate > first:
                    first, side = near / rate, -n * ti.math.sign(rate)
                last = ti.min(last, far / rate)
            elif near > 0 or far < 0:
                last = ti.cast(-1, ti.f32)
        if first < last and side.norm() > 0 and first < found[0]:
            found = ti.Vector([first, side[0], side[1], side[2]])
    return found


@ti.func
def _on_block(hit, at, up, light: ti.template(), blocks: ti.template(), width: ti.f32) -> ti.types.vector(3, ti.f32):
    """Colour of a block at a place where `_block` has met it; its edges are as dark as those of walls."""
    n = ti.Vector([hit[1], hit[2], hit[3]])
    out = ti.Vector([light[7, 0], light[7, 1], light[7, 2]]) * (0.82 + 0.18 * n.dot(up))
    edge = ti.cast(FAR, ti.f32)
    for b in range(blocks.shape[0]):
        place, apart, inside = at - ti.Vector([blocks[b, 0, 0], blocks[b, 0, 1], blocks[b, 0, 2]]), edge, True
        for k in ti.static(range(3)):
            side = ti.Vector([blocks[b, k + 1, 0], blocks[b, k + 1, 1], blocks[b, k + 1, 2]])
            length = side.norm()
            along = place.dot(side) / length
            inside = inside and along > -width and along < length + width
            if ti.abs(side.dot(n)) < 0.5 * length:
                apart = ti.min(apart, ti.min(along, length - along))
        if inside:
            edge = ti.min(edge, apart)
    share = ti.math.clamp(2.0 - edge / width, 0, 1)
    return out + (ti.Vector([light[6, 0], light[6, 1], light[6, 2]]) - out) * share


@ti.kernel
def _shade(
    depth: ti.types.ndarray(dtype=ti.f32, ndim=2),
    thickness: ti.types.ndarray(dtype=ti.f32, ndim=2),
    normal: ti.types.ndarray(dtype=ti.f32, ndim=3),
    flat: ti.types.ndarray(dtype=ti.i32, ndim=2),
    view: ti.types.ndarray(dtype=ti.f32, ndim=2),
    clear: ti.f32,
    light: ti.types.ndarray(dtype=ti.f32, ndim=2),
    planes: ti.types.ndarray(dtype=ti.f32, ndim=2),
    bases: ti.types.ndarray(dtype=ti.f32, ndim=3),
    step: ti.f32,
    blocks: ti.types.ndarray(dtype=ti.f32, ndim=3),
    image: ti.types.ndarray(dtype=ti.f32, ndim=3),
):
    """Colours (H / samples, W / samples, 3) of the pixels, written to ``image``.

    Args:
        depth, thickness, normal, flat: of samples, as in `Seen`.
        view: (7, 3) eye [m], the camera's axes, where the axis forwards meets the picture and the focal length [px],
            upwards, and the origin of the lines on the walls [m].
        clear: depth of fluid that takes about two thirds of the light [m].
        light: (8, 3) colours: ground, wall, line, sky, horizon, fluid, edge, block.
        planes: (P, 4) of the room.
        bases: (P, 3, 3) of the room, and the tone of each wall.
        step: between these [m].
        blocks: (B, 4, 3) a corner of each block and its edges there [m].
    """
    eye = ti.Vector([view[0, 0], view[0, 1], view[0, 2]])
    right = ti.Vector([view[1, 0], view[1, 1], view[1, 2]])
    down = ti.Vector([view[2, 0], view[2, 1], view[2, 2]])
    ahead = ti.Vector([view[3, 0], view[3, 1], view[3, 2]])
    focal, up = view[4, 2], ti.Vector([view[5, 0], view[5, 1], view[5, 2]])
    samples = depth.shape[0] // image.shape[0]
    sun = (up + 0.5 * (down.cross(up)) - 0.6 * ahead).normalized()
    for row in range(image.shape[0]):
        for column in range(image.shape[1]):
            total = ti.Vector([ti.cast(0, ti.f32), ti.cast(0, ti.f32), ti.cast(0, ti.f32)])
            for j in range(samples):
                for i in range(samples):
                    y, x = row * samples + j, column * samples + i
                    px = (ti.cast(x, ti.f32) + 0.5) / samples - view[4, 0]
                    py = (ti.cast(y, ti.f32) + 0.5) / samples - view[4, 1]
                    ray = right * (px / focal) + down * (py / focal) + ahead
                    stretch = ray.norm()
                    z = depth[y, x]
                    solid = _block(eye, ray, blocks)
                    if solid[0] < z:
                        total += _on_block(solid, eye + ray * solid[0], up, light, blocks, solid[0] / focal)
                    elif z < FAR:
                        place = eye + ray * z
                        ray = ray / stretch
                        n = ti.Vector([normal[y, x, 0], normal[y, x, 1], normal[y, x, 2]]).normalized()
                        facing = -n.dot(ray)
                        if facing < 0.02:  # smoothed normals may look away at the rim
                            n = (n - ray * (0.02 - facing)).normalized()
                            facing = -n.dot(ray)
                        share = 0.02 + 0.98 * ti.pow(ti.cast(1 - facing, ti.f32), 5)
                        into = ray
                        if flat[y, x] == 0:
                            root = 1 - (1 - facing * facing) / (INDEX * INDEX)
                            into = ray / INDEX + n * (facing / INDEX - ti.sqrt(root))
                        else:
                            share *= 0.25  # of glass, which would mirror what is around it
                        # A little within, so that the ray does not leave by the wall that it enters by.
                        start = place + into * (1e-4 * z)
                        behind = _walls(start, into, light, planes, bases, view, step, z, focal)
                        through = ti.max(thickness[y, x], 0)
                        wet = _block(start, into, blocks)
                        if wet[0] < FAR:
                            width = (z + wet[0]) / focal
                            behind = _on_block(wet, start + into * wet[0], up, light, blocks, width)
                            through = ti.min(through, wet[0] / stretch)
                        long = through * stretch / clear
                        mirrored = ray + 2 * facing * n
                        height = 0.5 + 0.5 * mirrored.dot(up)
                        sky = ti.Vector([light[4, 0], light[4, 1], light[4, 2]]) * (1 - height)
                        sky += ti.Vector([light[3, 0], light[3, 1], light[3, 2]]) * height
                        glint = ti.pow(ti.cast(ti.max(mirrored.dot(sun), 0), ti.f32), 90) * 0.7
                        if flat[y, x] == 1:
                            glint = 0
                        lit = 0.72 + 0.28 * ti.max(n.dot(up), 0)
                        for k in ti.static(range(3)):
                            own = light[5, k]
                            # What a fluid's colour lacks is absorbed first.
                            kept = (1 - THIN) * ti.exp(ti.cast(-long * (0.35 + 1.6 * (1 - own)), ti.f32))
                            body = behind[k] * kept + own * lit * (1 - kept)
                            total[k] += ti.math.clamp(body * (1 - share) + sky[k] * share + glint, 0, 1)
                    else:
                        total += _walls(eye, ray, light, planes, bases, view, step, 0, focal)
            for k in ti.static(range(3)):
                image[row, column, k] = total[k] / (samples * samples)


def look_at(surface: Surface, camera: Camera, size: tuple[int, int], samples: int, spacing: float) -> Seen:
    """A surface with its normals as a camera sees it, smoothed, in a picture of a size (width, height) [px]."""
    ensure_runtime()
    width, height = size
    shape = height * samples, width * samples
    depth, thickness = np.full(shape, FAR, np.float32), np.zeros(shape, np.float32)
    normal, flat = np.zeros((*shape, 3), np.float32), np.zeros(shape, np.int32)
    if not len(surface.faces):
        return Seen(depth, thickness, normal, flat)
    seen = camera.seen(surface.points)[surface.faces].astype(np.float32)
    normals = surface.normals[surface.faces].astype(np.float32)
    a, b, c = np.moveaxis(surface.points[surface.faces[surface.flat]], 1, 0)
    plane = np.cross(b - a, c - a)
    plane /= np.maximum(np.linalg.norm(plane, axis=1, keepdims=True), 1e-300)
    normals[surface.flat] = plane[:, None]
    vertices = np.ascontiguousarray(seen[..., :2])
    snapped, start, listed, _ = in_bands(vertices, samples, width, height)
    far, along = np.ascontiguousarray(seen[..., 2]), surface.flat.astype(np.int32)
    _paint_depth(samples, snapped, start, listed, vertices, far, normals, along, depth, thickness, normal, flat)
    middle = float(np.median(far))
    reach = min(round(REACH * spacing * camera.focal / middle * samples), MOST_REACH)
    if reach > 0:
        for across in (1, 0):
            new = np.empty_like(depth), np.empty_like(normal)
            _smooth(depth, normal, flat, reach, SAME * spacing, across, *new)
            depth, normal = new
    return Seen(depth, thickness, normal, flat)


def shaded(
    seen: Seen,
    camera: Camera,
    room: Room,
    blocks: Array,
    up: Array,
    light: Light,
    edge: Array,
    step: float,
    samples: int,
) -> Array:
    """Colours (H, W, 3) in [0, 1] of a surface in a room, with ``step`` [m] between lines on the walls.

    ``blocks`` (B, 8, 3) are the corners of those in it, see `tipfem.render.blocks` [m].
    """
    lens = [*camera.centre, camera.focal]
    view = np.concatenate([[camera.eye], camera.axes, [lens, up, room.origin]]).astype(np.float32)
    tone = 0.97 + 0.03 * (-room.planes[:, :3] @ up)  # floors are lit, and ceilings are not
    bases = np.concatenate([room.bases, np.repeat(tone[:, None, None], 3, axis=2)], axis=1).astype(np.float32)
    colours = np.stack([*light[:-1], edge, light.ground + BLOCK * (edge - light.ground)]).astype(np.float32)
    sides = (blocks[:, [0, 1, 3, 4]] - blocks[:, [0]] * [[[0], [1], [1], [1]]]).astype(np.float32)
    shape = seen.depth.shape[0] // samples, seen.depth.shape[1] // samples, 3
    image = np.empty(shape, np.float32)
    planes = room.planes.astype(np.float32)
    facts = view, light.clear, colours, planes, bases, step, sides
    _shade(*seen, *facts, image)
    return image
