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
from .runtime import Bytes3, Floats2, Floats3, Ints1, Ints2, ensure_runtime, ti
from .surface import Surface

FAR = 1e30  # depth where there is nothing
THIN = 0.2  # of the light is kept by the thinnest fluid, so that it is seen
INDEX = 1.33  # of refraction
REACH = 0.35  # of the smoothing [spacings]
MOST_REACH = 8  # [samples]
EDGE = 0.55  # of the colour of edges before the fluid that those behind it have
BLOCK = 0.6  # of the colour of these that blocks have
SAME = 2.0  # difference of depth at which smoothing ends [spacings]
ALIKE = 0.9995  # length of the mean of a pixel's normals, above which they are taken for one
LEVEL = 0.5  # difference of depth in a pixel, up to which it is taken for one [spacings]


class Seen(NamedTuple):
    """A surface in a picture of H x W samples."""

    depth: Array  # (H, W) of the front faces along the camera's axis [m], `FAR` where there are none
    thickness: Array  # (H, W) of the fluid along the camera's axis [m]
    normal: Array  # (H, W, 3) outwards at the front
    flat: Array  # (H, W) 1 where the front is a face along a wall
    box: Array  # (4,) first and last column and row of the samples that it can cover


class Scenery(NamedTuple):
    """A tank and its light, as kernels take them."""

    view: Array  # (8, 3) see `scenery`
    light: Array  # (9, 3) colours: ground, wall, line, sky, horizon, fluid, edge, block, edge before the fluid
    walls: Array  # (P, 4, 3) directions along each and its normal, and its distance from the origin [m] and tone
    blocks: Array  # (B, 4, 3) a corner of each block and its edges there [m]


class Empty(NamedTuple):
    """A picture of a tank without fluid."""

    colours: Array  # (H, W, 4) behind the fluid, in [0, 1], and the share of edges before it
    solid: Array  # (H samples, W samples) depth of blocks along the camera's axis [m], `FAR` where there are none
    image: Array  # (H, W, 3) uint8


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
    snapped: Ints2,
    start: Ints1,
    listed: Ints1,
    vertices: Floats3,
    far: Floats2,
    normals: Floats3,
    along: Ints1,
    depth: Floats2,
    thickness: Floats2,
    normal: Floats3,
    flat: Ints2,
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
    depth: Floats2,
    normal: Floats3,
    flat: Ints2,
    box: ti.types.vector(4, ti.i32),
    reach: ti.i32,
    same: ti.f32,
    across: ti.i32,
    new_depth: Floats2,
    new_normal: Floats3,
):
    """Smooth depth and normals off walls along one axis, rows or columns, each with those of nearly its depth.

    The filter has a ``reach`` [samples]; weights end at a difference of depth ``same`` [m]. Left out is what is outside
    ``box``, the first and last column and row of samples.
    """
    for y in range(box[2], box[3] + 1):
        for x in range(box[0], box[1] + 1):
            z = depth[y, x]
            n = ti.Vector([normal[y, x, 0], normal[y, x, 1], normal[y, x, 2]])
            if z < FAR and flat[y, x] == 0:
                total, mean, turned = z * 0, z * 0, n * 0
                at, low, high = y, box[2], box[3]
                if across == 1:
                    at, low, high = x, box[0], box[1]
                for k in range(ti.max(-reach, low - at), ti.min(reach, high - at) + 1):
                    j, i = y + k * (1 - across), x + k * across
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
def _walls(at, ray, view: ti.template(), light: ti.template(), walls: ti.template(), before: ti.f32) -> ti.types.vector(
    3, ti.f32
):
    """Colour of the walls of the room where a ray leaves it, from a point before of the eye; the ground's outside."""
    step, focal = view[7, 1], view[4, 2]
    first, last, plane = ti.cast(-FAR, ti.f32), ti.cast(FAR, ti.f32), -1
    for k in range(walls.shape[0]):
        n = ti.Vector([walls[k, 2, 0], walls[k, 2, 1], walls[k, 2, 2]])
        rate, room = n.dot(ray), walls[k, 3, 0] - n.dot(at)
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
            u = place.dot(ti.Vector([walls[plane, m, 0], walls[plane, m, 1], walls[plane, m, 2]])) / step
            apart = ti.abs(u - ti.floor(u + 0.5)) * step
            share = ti.max(share, ti.math.clamp(1.5 - apart / width, 0, 1))
        # Walls are lit from above: each has its own tone.
        tone = walls[plane, 3, 1]
        out = (wall + (line - wall) * share) * tone
        edge = ti.cast(FAR, ti.f32)
        for k in range(walls.shape[0]):  # the edges between walls behind the fluid
            if k != plane:
                n = ti.Vector([walls[k, 2, 0], walls[k, 2, 1], walls[k, 2, 2]])
                edge = ti.min(edge, walls[k, 3, 0] - n.dot(at + ray * last))
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


@ti.func
def _ray(x: ti.f32, y: ti.f32, view: ti.template()) -> ti.types.vector(3, ti.f32):
    """Direction through a place (x, y) [px] of the picture, one metre along the camera's axis."""
    right = ti.Vector([view[1, 0], view[1, 1], view[1, 2]])
    down = ti.Vector([view[2, 0], view[2, 1], view[2, 2]])
    ahead = ti.Vector([view[3, 0], view[3, 1], view[3, 2]])
    return right * ((x - view[4, 0]) / view[4, 2]) + down * ((y - view[4, 1]) / view[4, 2]) + ahead


@ti.kernel
def _paint_empty(
    samples: ti.i32, view: Floats2, light: Floats2, walls: Floats3, blocks: Floats3, colours: Floats3, solid: Floats2
):
    """Write ``colours`` and ``solid`` of `Empty`, but for the lines before the fluid; see `Scenery` for the others."""
    eye, up = ti.Vector([view[0, 0], view[0, 1], view[0, 2]]), ti.Vector([view[5, 0], view[5, 1], view[5, 2]])
    for row in range(colours.shape[0]):
        for column in range(colours.shape[1]):
            total = ti.Vector([ti.cast(0, ti.f32), ti.cast(0, ti.f32), ti.cast(0, ti.f32)])
            for j in range(samples):
                for i in range(samples):
                    y, x = row * samples + j, column * samples + i
                    ray = _ray((ti.cast(x, ti.f32) + 0.5) / samples, (ti.cast(y, ti.f32) + 0.5) / samples, view)
                    hit = _block(eye, ray, blocks)
                    solid[y, x] = hit[0]
                    if hit[0] < FAR:
                        total += _on_block(hit, eye + ray * hit[0], up, light, blocks, hit[0] / view[4, 2])
                    else:
                        total += _walls(eye, ray, view, light, walls, 0)
            for k in ti.static(range(3)):
                colours[row, column, k] = total[k] / (samples * samples)


@ti.kernel
def _shade(
    depth: Floats2,
    thickness: Floats2,
    normal: Floats3,
    flat: Ints2,
    box: ti.types.vector(4, ti.i32),
    view: Floats2,
    light: Floats2,
    walls: Floats3,
    blocks: Floats3,
    colours: Floats3,
    solid: Floats2,
    image: Bytes3,
):
    """Paint the pixels of an ``image`` (H / samples, W / samples, 3) within ``box``; args are of the named tuples.

    The samples of a pixel that are much alike are shaded as one.
    """
    eye, up = ti.Vector([view[0, 0], view[0, 1], view[0, 2]]), ti.Vector([view[5, 0], view[5, 1], view[5, 2]])
    down = ti.Vector([view[2, 0], view[2, 1], view[2, 2]])
    ahead = ti.Vector([view[3, 0], view[3, 1], view[3, 2]])
    focal, samples = view[4, 2], depth.shape[0] // image.shape[0]
    many = samples * samples
    sun = (up + 0.5 * (down.cross(up)) - 0.6 * ahead).normalized()
    for row in range(box[2] // samples, box[3] // samples + 1):
        for column in range(box[0] // samples, box[1] // samples + 1):
            wet, alike = 0, 1
            nearest, furthest, filled = ti.cast(FAR, ti.f32), ti.cast(0, ti.f32), ti.cast(0, ti.f32)
            mean = ti.Vector([ti.cast(0, ti.f32), ti.cast(0, ti.f32), ti.cast(0, ti.f32)])
            for s in range(many):
                y, x = row * samples + s // samples, column * samples + s % samples
                if depth[y, x] < solid[y, x]:
                    wet += 1
                    nearest, furthest = ti.min(nearest, depth[y, x]), ti.max(furthest, depth[y, x])
                    filled += thickness[y, x] / many
                    mean += ti.Vector([normal[y, x, 0], normal[y, x, 1], normal[y, x, 2]]).normalized() / many
                    if flat[y, x] != flat[row * samples, column * samples]:
                        alike = 0
            if wet < many or mean.norm() < ALIKE or furthest - nearest > view[7, 2]:
                alike = 0
            total = ti.Vector([colours[row, column, 0], colours[row, column, 1], colours[row, column, 2]]) * (
                1 - ti.cast(wet, ti.f32) / many
            )
            for s in range(many * (1 - alike) + alike):
                y, x = row * samples + s // samples, column * samples + s % samples
                if depth[y, x] < solid[y, x]:
                    z, through, part = depth[y, x], thickness[y, x], ti.cast(1, ti.f32) / many
                    px, py = (ti.cast(x, ti.f32) + 0.5) / samples, (ti.cast(y, ti.f32) + 0.5) / samples
                    n = ti.Vector([normal[y, x, 0], normal[y, x, 1], normal[y, x, 2]])
                    if alike == 1:
                        z, through, n, part = (nearest + furthest) / 2, filled, mean, 1
                        px, py = ti.cast(column, ti.f32) + 0.5, ti.cast(row, ti.f32) + 0.5
                    n = n.normalized()
                    ray = _ray(px, py, view)
                    stretch = ray.norm()
                    place = eye + ray * z
                    ray = ray / stretch
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
                    behind = _walls(start, into, view, light, walls, z)
                    through = ti.max(through, 0)
                    hit = _block(start, into, blocks)
                    if hit[0] < FAR:
                        behind = _on_block(hit, start + into * hit[0], up, light, blocks, (z + hit[0]) / focal)
                        through = ti.min(through, hit[0] / stretch)
                    long = through * stretch / view[7, 0]
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
                        total[k] += part * ti.math.clamp(body * (1 - share) + sky[k] * share + glint, 0, 1)
            for k in ti.static(range(3)):
                seen = total[k] + colours[row, column, 3] * (light[8, k] - total[k])
                image[row, column, k] = ti.cast(seen * 255 + 0.5, ti.u8)


def look_at(surface: Surface, camera: Camera, size: tuple[int, int], samples: int, spacing: float) -> Seen:
    """A surface with its normals as a camera sees it, smoothed, in a picture of a size (width, height) [px]."""
    ensure_runtime()
    width, height = size
    shape = height * samples, width * samples
    depth, thickness = np.full(shape, FAR, np.float32), np.zeros(shape, np.float32)
    normal, flat = np.zeros((*shape, 3), np.float32), np.zeros(shape, np.int32)
    if not len(surface.faces):
        return Seen(depth, thickness, normal, flat, np.array([0, -1, 0, -1]))
    seen = camera.seen(surface.points)[surface.faces].astype(np.float32)
    normals = surface.normals[surface.faces].astype(np.float32)
    a, b, c = np.moveaxis(surface.points[surface.faces[surface.flat]], 1, 0)
    plane = np.cross(b - a, c - a)
    plane /= np.maximum(np.linalg.norm(plane, axis=1, keepdims=True), 1e-300)
    normals[surface.flat] = plane[:, None]
    vertices = np.ascontiguousarray(seen[..., :2])
    snapped, start, listed, extent = in_bands(vertices, samples, width, height)
    far, along = np.ascontiguousarray(seen[..., 2]), surface.flat.astype(np.int32)
    _paint_depth(samples, snapped, start, listed, vertices, far, normals, along, depth, thickness, normal, flat)
    bands = np.flatnonzero(np.diff(start))
    rows = bands.min(initial=height) * BAND * samples, min((bands.max(initial=-1) + 1) * BAND, height) * samples - 1
    box = np.array([extent[:, 0].min(), extent[:, 1].max(), *rows], np.int32)
    reach = min(round(REACH * spacing * camera.focal / float(np.median(far)) * samples), MOST_REACH)
    if reach > 0:
        across = np.empty_like(depth), np.empty_like(normal)
        _smooth(depth, normal, flat, ti.Vector(box), reach, SAME * spacing, 1, *across)
        _smooth(*across, flat, ti.Vector(box), reach, SAME * spacing, 0, depth, normal)
    return Seen(depth, thickness, normal, flat, box)


def scenery(
    camera: Camera, room: Room, blocks: Array, up: Array, light: Light, edge: Array, step: float, spacing: float
) -> Scenery:
    """A room in light, with ``step`` [m] between lines on the walls.

    Args:
        camera: that looks at it.
        room: the space between the walls.
        blocks: (B, 8, 3) corners of those in it, see `tipfem.render.blocks` [m].
        up: (3,) upwards.
        light: colours.
        edge: (3,) colour of the edges before the fluid, mixed with that of the ground for those behind it.
        step: see above.
        spacing: of the particles [m].
    """
    # Rows: eye, axes, where that forwards meets the picture and the focal length [px], up, origin of the lines, and
    # the depth that takes the light, what is between the lines, and the difference of depths that is taken for none.
    lens, lengths = [*camera.centre, camera.focal], [light.clear, step, LEVEL * spacing]
    view = np.concatenate([[camera.eye], camera.axes, [lens, up, room.origin, lengths]])
    tone = 0.97 + 0.03 * (-room.planes[:, :3] @ up)  # floors are lit, and ceilings are not
    facts = np.stack([room.planes[:, 3], tone, 0 * tone], axis=1)
    walls = np.concatenate([room.bases, room.planes[:, None, :3], facts[:, None]], axis=1)
    inner = light.ground + EDGE * (edge - light.ground), light.ground + BLOCK * EDGE * (edge - light.ground)
    colours = np.stack([*light[:-1], *inner, edge])
    sides = blocks[:, [0, 1, 3, 4]] - blocks[:, [0]] * [[[0], [1], [1], [1]]]
    return Scenery(*(values.astype(np.float32) for values in (view, colours, walls, sides)))


def empty(tank: Scenery, share: Array, samples: int) -> Empty:
    """A picture of a tank without fluid, with the share (H, W) of edges before the fluid in its pixels."""
    ensure_runtime()
    colours = np.empty((*share.shape, 4), np.float32)
    solid = np.empty((share.shape[0] * samples, share.shape[1] * samples), np.float32)
    _paint_empty(samples, *tank, colours, solid)
    colours[..., 3] = share
    behind = colours[..., :3]
    image = behind + share[..., None] * (tank.light[8] - behind)
    return Empty(colours, solid, np.floor(255 * image + 0.5).astype(np.uint8))


def shaded(seen: Seen, tank: Scenery, without: Empty) -> Array:
    """Picture (H, W, 3) uint8 of a surface in a tank, of which that ``without`` fluid is known."""
    image: Array = without.image.copy()
    if seen.box[0] <= seen.box[1]:
        _shade(*seen[:4], ti.Vector(seen.box), *tank, without.colours, without.solid, image)
    return image
