"""Connected components against a flood fill, and volumes that come back."""

import dataclasses

import numpy as np
import pytest
from triangulations import cloud, component_labels, delaunay, grid

from tipfem.backend.launch import every_schedule, launch
from tipfem.geometry.period import Period
from tipfem.mesh.components import ON_HULL, ON_INTERFACE, Components
from tipfem.mesh.delaunay import triangulate
from tipfem.mesh.mesh import Mesh, simplex_measure
from tipfem.remesh import volume_kernels, volumes
from tipfem.remesh.volumes import (
    apportion,
    areas,
    component_numbers,
    label_components,
    restore_volumes,
    transfer_deficits,
    with_components,
)


def flood(neighbours, fluid) -> list[set[int]]:
    """Connected cells of one fluid, cell by cell."""
    left, found = set(range(len(fluid))), []
    while left:
        component, front = set(), [min(left)]
        while front:
            t = front.pop()
            if t not in component:
                component.add(t)
                front += [o for o in neighbours[t] if o >= 0 and fluid[o] == fluid[t]]
        left -= component
        found.append(component)
    return found


@pytest.mark.parametrize("width", [0.0, 1.0])
def test_areas_are_those_of_numpy(width):
    """Of inverted triangles too, and across a periodic side."""
    x, period = cloud("random", 4), Period(np.array([width, 0.0]))
    mesh = Mesh(x, delaunay(x).astype(np.int32), period=period)
    moved = x + np.random.default_rng(4).normal(size=x.shape)
    expected = simplex_measure(moved, mesh.cells, period)
    assert (expected < 0).any()
    np.testing.assert_allclose(areas(moved, mesh), expected, rtol=1e-12, atol=1e-15)


def test_components_are_those_of_a_flood_fill():
    for seed in range(30):
        x = cloud("random", seed)
        mesh = Mesh(x, delaunay(x))
        for fluids in (1, 2, 4):
            fluid = np.random.default_rng(seed).integers(0, fluids, len(mesh.cells), dtype=np.int32)
            label = component_labels(mesh.neighbours, fluid)
            found = [set(np.flatnonzero(label == k).tolist()) for k in range(label.max() + 1)]
            assert sorted(map(sorted, found)) == sorted(map(sorted, flood(mesh.neighbours, fluid)))


def test_components_do_not_depend_on_how_many_threads_find_them():
    """With removed cells, and one component of a fluid around many of the other."""
    rng = np.random.default_rng(0)
    x = rng.random((4000, 2))
    mesh = Mesh(x, delaunay(x))
    fluid = (rng.random(len(mesh.cells)) < 0.3).astype(np.int32)
    fluid[rng.random(len(fluid)) < 0.02] = -1
    found = [label_components(x, mesh.cells, mesh.neighbours, fluid, 2) for _ in every_schedule()]
    assert len(found[0][0]) > 500
    for components, measure, volume in found[1:]:
        for field in dataclasses.fields(components):
            np.testing.assert_array_equal(*(getattr(each, field.name) for each in (components, found[0][0])))
        np.testing.assert_array_equal(measure[fluid >= 0], found[0][1][fluid >= 0])
        np.testing.assert_array_equal(volume, found[0][2])


def test_components_are_numbered_by_size_and_labelled_once():
    x = cloud("random", 3)
    fluid = np.random.default_rng(3).integers(0, 3, len(delaunay(x)), dtype=np.int32)
    mesh = with_components(Mesh(x, delaunay(x), fluid), 3)
    label = mesh.components.label
    pairs = np.unique(np.stack([label, component_labels(mesh.neighbours, fluid)]), axis=1)
    assert pairs.shape[1] == label.max() + 1 == len(mesh.components)
    volume = np.bincount(label, weights=mesh.measure)
    assert len(volume) > 10
    assert (np.diff(volume) <= 0).all()
    np.testing.assert_array_equal(mesh.components.fluid[label], fluid)
    assert with_components(mesh, 3) is mesh
    assert mesh.moved(x + 1.0).components is mesh.components
    with pytest.raises(ValueError, match="no fluids"):
        with_components(Mesh(x, delaunay(x)), 3)


@pytest.mark.parametrize("dim", [2, 3])
def test_components_know_their_fluids_particles_volumes_and_what_may_move(dim):
    for seed in range(10):
        x = cloud("random", seed) if dim == 2 else np.random.default_rng(seed).random((40, 3))
        cells = delaunay(x) if dim == 2 else triangulate(x, np.zeros(len(x), dtype=bool), 0.3).cells
        fluid = np.random.default_rng(seed).integers(0, 3, len(cells), dtype=np.int32)
        mesh = Mesh(x, cells, fluid)
        components, measure, volume = label_components(x, cells, mesh.neighbours, fluid, 4)
        label = components.label
        atol = 0.0 if dim == 2 else 1e-16
        np.testing.assert_allclose(measure, mesh.measure, rtol=1e-13, atol=atol)
        np.testing.assert_allclose(volume, np.bincount(label, weights=mesh.measure), rtol=1e-13, atol=atol)
        found = [set(np.flatnonzero(label == k).tolist()) for k in range(label.max() + 1)]
        assert sorted(map(sorted, found)) == sorted(map(sorted, flood(mesh.neighbours, fluid)))
        numbers, count = component_numbers(x, cells, mesh.neighbours, fluid)
        assert len(np.unique(np.stack([label, numbers]), axis=1).T) == count == len(components)
        np.testing.assert_array_equal(components.fluid[label], fluid)
        for f in range(4):
            for n in range(len(x)):
                around = set(label[(cells == n).any(axis=1) & (fluid == f)].tolist())
                found = int(components.at_particle[f, n])
                assert found in around if around else found == -1
        movable = components.mark == ON_INTERFACE
        np.testing.assert_array_equal(components.movable_particles, np.flatnonzero(movable))
        np.testing.assert_array_equal(components.interface_cells, np.flatnonzero(movable[cells].any(axis=1)))
        expected = [movable[cells[label == k]].any() for k in range(len(components))]
        np.testing.assert_array_equal(components.movable, expected)
        cell, i = np.nonzero(mesh.neighbours < 0)
        on_hull = np.unique(np.stack([cells[cell, (i + k) % (dim + 1)] for k in range(1, dim + 1)]))
        np.testing.assert_array_equal(np.flatnonzero(components.mark & ON_HULL), on_hull)


def test_components_of_renumbered_particles():
    x = cloud("random", 4)
    fluid = np.random.default_rng(4).integers(0, 2, len(delaunay(x)), dtype=np.int32)
    components = with_components(Mesh(x, delaunay(x), fluid), 2).components
    kept = np.arange(len(x))[::-1]
    renumbered = components.renumbered(kept)
    np.testing.assert_array_equal(renumbered.at_particle, components.at_particle[:, ::-1])
    np.testing.assert_array_equal(renumbered.mark, components.mark[::-1])
    assert renumbered.label is components.label


# A strip of eight triangles, four squares in a row: particles 0 to 4 below, 5 to 9 above.
STRIP = np.array([[k, k + 1, k + 6] for k in range(4)] + [[k, k + 6, k + 5] for k in range(4)])
SQUARE = np.tile(np.arange(4), 2)
STAYED = np.zeros(10, dtype=bool)


def strip(*fluid: int):
    """Mesh and component labels where the squares have these fluids."""
    return labelled(STRIP, np.array(fluid, dtype=np.int32)[SQUARE])


def labelled(cells, fluid):
    """The mesh of the strip with these cells and fluids, and its component labels."""
    position = np.stack([np.arange(10) % 5, np.arange(10) // 5], axis=1).astype(float)
    mesh = with_components(Mesh(position, cells.astype(np.int32), fluid), 2)
    return mesh, mesh.components.label


def transferred(old, new, deficit, moved):
    """`transfer_deficits` between two strips."""
    one, other = old[0].components, new[0].components
    return transfer_deficits(one.at_particle, other.at_particle, deficit, moved, len(other))


def test_a_deficit_stays_with_its_component():
    old = strip(0, 0, 1, 1)
    loss = np.array([0.0, 0.0])
    loss[old[1][0]], loss[old[1][2]] = 3.0, -2.0
    np.testing.assert_allclose(transferred(old, old, loss, STAYED), loss, rtol=1e-14)
    # The same cells in another order: components have other numbers then.
    reverse = np.arange(8)[::-1]
    new = labelled(STRIP[reverse], old[0].fluid[reverse])
    np.testing.assert_allclose(transferred(old, new, loss, STAYED)[new[1][reverse]], loss[old[1]], rtol=1e-14)


def test_components_that_merge_add_their_losses():
    old, new = strip(0, 1, 1, 0), strip(0, 0, 0, 0)
    loss = np.zeros(3)
    loss[old[1][0]], loss[old[1][3]] = 3.0, 5.0  # of the two components of fluid 0
    np.testing.assert_allclose(transferred(old, new, loss, STAYED), [8.0], rtol=1e-14)


def test_a_component_that_splits_shares_its_loss_by_particles():
    old, new = strip(0, 0, 0, 0), strip(0, 0, 1, 0)  # six particles go left, four right
    shares = transferred(old, new, np.array([10.0]), STAYED)
    assert shares[new[1][0]] == pytest.approx(6.0, rel=1e-14)
    assert shares[new[1][3]] == pytest.approx(4.0, rel=1e-14)
    assert shares[new[1][2]] == 0.0


def test_relocated_particles_transfer_nothing():
    old, new = strip(0, 0, 0, 0), strip(0, 0, 1, 0)
    moved = STAYED.copy()
    moved[[0, 5, 1]] = True  # three of the left component's six
    shares = transferred(old, new, np.array([14.0]), moved)
    assert shares[new[1][0]] == pytest.approx(6.0, rel=1e-14)
    assert shares[new[1][3]] == pytest.approx(8.0, rel=1e-14)


def test_what_a_vanished_component_lost_is_in_none():
    old, new = strip(0, 0, 1, 1), strip(0, 0, 0, 0)
    loss = np.zeros(2)
    loss[old[1][3]] = 7.0
    np.testing.assert_array_equal(transferred(old, new, loss, STAYED), [0.0])


def test_shares_fill_the_tank_and_give_each_fluid_its_total():
    rng = np.random.default_rng(0)
    for _ in range(50):
        fluid = rng.permutation(np.concatenate([np.arange(3), rng.integers(0, 3, 4)]))
        volume = rng.uniform(0.5, 1.0, 7)
        loss = rng.uniform(-0.1, 0.1, 7)
        total = rng.uniform(0.9, 1.1, 3) * np.bincount(fluid, weights=volume)
        total *= volume.sum() / total.sum()
        wanted = apportion(volume, loss, fluid, total, np.ones(7, dtype=bool))
        np.testing.assert_allclose(np.bincount(fluid, weights=wanted), total, rtol=1e-12)
        ratio = wanted / (volume + loss)  # beyond its own loss, a component takes part by its size
        for f in range(3):
            np.testing.assert_allclose(ratio[fluid == f], ratio[fluid == f][0], rtol=1e-12)


def test_losses_that_add_up_come_back_to_the_last_bit():
    volume, fluid = np.array([0.3, 0.2, 0.5]), np.array([0, 0, 1])
    loss = np.array([0.01, 0.0, -0.01])
    wanted = apportion(volume, loss, fluid, np.array([0.51, 0.49]), np.ones(3, dtype=bool))
    np.testing.assert_allclose(wanted, volume + loss, rtol=1e-14)


def test_components_that_cannot_move_keep_what_they_have_and_others_make_up_for_them():
    rng = np.random.default_rng(1)
    fluid = np.array([0, 0, 1, 1, 1, 2])
    free = np.array([True, False, True, True, False, True])
    for _ in range(20):
        volume = rng.uniform(0.5, 1.0, 6)
        loss = rng.uniform(-0.05, 0.05, 6)
        total = np.bincount(fluid, weights=volume) + [0.03, -0.07, 0.04]
        wanted = apportion(volume, loss, fluid, total, free)
        np.testing.assert_array_equal(wanted[~free], volume[~free])
        np.testing.assert_allclose(np.bincount(fluid, weights=wanted), total, rtol=1e-12)


def test_a_fluid_that_cannot_move_at_all_leaves_the_others_to_fill_the_tank():
    volume, fluid = np.array([0.3, 0.2, 0.5]), np.array([0, 1, 2])
    total = np.array([0.33, 0.25, 0.42])
    wanted = apportion(volume, np.zeros(3), fluid, total, np.array([True, False, True]))
    assert wanted[1] == 0.2
    assert wanted.sum() == pytest.approx(1.0, rel=1e-14)
    np.testing.assert_allclose(wanted[[0, 2]] - total[[0, 2]], 0.05 * volume[[0, 2]] / 0.8, rtol=1e-12)  # by size
    nothing = apportion(volume, np.array([0.1, -0.1, 0.0]), fluid, total, np.zeros(3, dtype=bool))
    np.testing.assert_array_equal(nothing, volume)


def test_no_component_is_asked_to_vanish_and_a_fluid_that_is_gone_leaves_a_full_tank():
    volume, fluid = np.array([0.4, 0.6]), np.array([0, 2])
    wanted = apportion(volume, np.array([-0.7, 0.7]), fluid, np.array([0.4, 0.0, 0.6]), np.ones(2, dtype=bool))
    assert (wanted > 0.1).all()
    wanted = apportion(volume, np.zeros(2), fluid, np.array([0.4, 0.1, 0.5]), np.ones(2, dtype=bool))
    np.testing.assert_allclose(wanted, [0.44, 0.56], rtol=1e-12)  # 0.1 is left, for both by size


def move_interfaces(x, cells, label, movable, wanted, limit):
    """Positions from `volumes.move_interfaces`, of cells whose labels and movable particles are given."""
    label, mark = label.astype(np.int32), np.where(movable, ON_INTERFACE, 0).astype(np.int32)
    near, nothing = np.flatnonzero(movable[cells].any(axis=1)).astype(np.int32), np.zeros((0, len(x)), dtype=np.int32)
    components = Components(label, label, nothing, mark, np.ones(len(wanted), dtype=bool), near)
    mesh = Mesh(x, np.ascontiguousarray(cells, dtype=np.int32), components=components)
    volume = np.bincount(label, weights=mesh.measure, minlength=len(wanted))
    moved = volumes.move_interfaces(mesh, volume, wanted, limit)
    assert (moved is mesh) == (not movable.any())
    np.testing.assert_array_equal(moved.measure, simplex_measure(moved.position, mesh.cells))
    return moved.position


def discs():
    """A mesh with three components of fluid 1 in fluid 0: position, mesh, components, and who may move."""
    n = 25
    x = np.stack(np.meshgrid(np.arange(n), np.arange(n)), axis=-1).reshape(-1, 2) / (n - 1)
    inside = (x > 0).all(axis=1) & (x < 1).all(axis=1)
    x[inside] += np.random.default_rng(5).uniform(-0.2, 0.2, (inside.sum(), 2)) / (n - 1)
    mesh = Mesh(x, delaunay(x))
    middle = x[mesh.cells].mean(axis=1)
    fluid = np.zeros(len(middle), dtype=int)
    for centre, radius in (((0.25, 0.3), 0.15), ((0.7, 0.7), 0.2), ((1.0, 0.2), 0.17)):
        fluid[np.linalg.norm(middle - centre, axis=1) < radius] = 1
    label = component_labels(mesh.neighbours, fluid)
    edge, i = np.nonzero((mesh.neighbours >= 0) & (fluid[mesh.neighbours] != fluid[:, None]))
    on = np.zeros(len(x), dtype=bool)
    on[mesh.cells[edge, (i + 1) % 3]] = True
    return x, mesh, label, on & inside


def test_interfaces_move_until_every_component_has_its_volume():
    x, mesh, label, movable = discs()
    volume = np.bincount(label, weights=mesh.measure)
    assert len(volume) == 4
    rng = np.random.default_rng(6)
    for size, tolerance in ((1e-4, 1e-12), (2e-2, 1e-6)):  # two rounds of Newton's method
        factor = 1 + size * rng.uniform(-1, 1, 4)
        main = int(np.argmax(volume))
        wanted = volume * factor
        wanted[main] = 1.0 - np.delete(wanted, main).sum()
        y = move_interfaces(x, mesh.cells, label, movable, wanted, 0.01)
        has = np.bincount(label, weights=simplex_measure(y, mesh.cells))
        np.testing.assert_allclose(has, wanted, rtol=tolerance)
        np.testing.assert_array_equal(y[~movable], x[~movable])
        assert not np.array_equal(y[movable], x[movable])
        assert np.linalg.norm(y - x, axis=1).max() < 10 * size * 0.2


def test_a_component_alone_that_grows_moves_its_own_surface_most():
    x, mesh, label, movable = discs()
    volume = np.bincount(label, weights=mesh.measure)
    small = int(np.argmin(np.abs(volume - np.pi * 0.15**2)))
    wanted = volume.copy()
    wanted[small] *= 1.01
    wanted[np.argmax(volume)] -= wanted.sum() - 1.0
    shift = np.linalg.norm(move_interfaces(x, mesh.cells, label, movable, wanted, 0.01) - x, axis=1)
    own = np.zeros(len(x), dtype=bool)
    own[mesh.cells[label == small]] = True
    assert shift[own].max() > 1e-4
    assert shift[~own].max() < 1e-10


def test_no_particle_goes_further_than_the_limit():
    x, mesh, label, movable = discs()
    volume = np.bincount(label, weights=mesh.measure)
    wanted = 0.5 * volume
    wanted[np.argmax(volume)] += 0.5
    shift = np.linalg.norm(move_interfaces(x, mesh.cells, label, movable, wanted, 1e-3) - x, axis=1)
    assert 1e-3 < shift.max() <= 4e-3 * (1 + 1e-12)  # four rounds


@pytest.mark.parametrize("limit", [0.002, 1.0])
def test_no_triangle_is_halved_in_a_round(limit):
    """Whatever is asked for, and however far particles may go: there are four rounds, and none turns a triangle."""
    x, mesh, label, movable = discs()
    for seed in range(8):
        wanted = np.random.default_rng(seed).uniform(0.0, 1.0, 4)
        y = move_interfaces(x, mesh.cells, label, movable, wanted / wanted.sum(), limit)
        assert (simplex_measure(y, mesh.cells) >= 0.5**4 * mesh.measure).all()
        np.testing.assert_array_equal(y[~movable], x[~movable])
        assert limit > 0.1 or not np.array_equal(x, y)


def test_a_particle_that_would_flatten_a_triangle_is_held_and_the_others_go_on():
    """A thin triangle above one particle of a flat interface that is to rise: it stays and the others rise."""
    x, cells = grid(np.arange(9), np.arange(5))
    x[4 * 5 + 3, 1] = 2.05
    mesh = Mesh(x, cells)
    label = (x[cells, 1].mean(axis=1) > 2).astype(int)
    label[(cells == 4 * 5 + 3).any(axis=1)] = 1
    movable = (x[:, 1] == 2) & (x[:, 0] > 0) & (x[:, 0] < 8)
    volume = np.bincount(label, weights=mesh.measure)
    wanted = volume + [0.4, -0.4]
    y = move_interfaces(x, cells, label, movable, wanted, 0.5)
    np.testing.assert_allclose(np.bincount(label, weights=simplex_measure(y, cells)), wanted, rtol=1e-3)
    assert (simplex_measure(y, cells) >= 0.5**4 * mesh.measure).all()
    risen = y[movable, 1] - 2
    assert risen[3] < 0.05
    assert (risen[[0, 1, 5, 6]] > 0.03).all()


def gradients_by_numpy(x, cells, label, movable):
    """dV_k / dx (K, N, 2) at the movable particles."""
    result = np.zeros((label.max() + 1, len(x), 2))
    for k in range(3):
        side = x[cells[:, (k + 2) % 3]] - x[cells[:, (k + 1) % 3]]
        np.add.at(result, (label, cells[:, k]), 0.5 * np.stack([-side[:, 1], side[:, 0]], axis=1))
    result[:, ~movable] = 0.0
    return result


def test_gradients_and_their_products_are_those_of_numpy():
    x, mesh, label, movable = discs()
    expected = gradients_by_numpy(x, mesh.cells, label, movable)
    nodes = np.flatnonzero(movable).astype(np.int32)
    near = np.flatnonzero(movable[mesh.cells].any(axis=1)).astype(np.int32)
    head = np.full(len(x), volume_kernels.FIXED, dtype=np.int32)
    size = 3 * len(near)
    chain, entries, tangent = np.empty((size, 2), dtype=np.int32), np.empty((size, 2)), np.zeros((len(nodes), 2))
    lists = volume_kernels.Gradients(head, chain, entries)
    given = x, mesh.cells, mesh.period.array, label, near, nodes, tangent, lists
    pair = np.empty((launch(volume_kernels.gradients, *given), 2), dtype=np.int32)
    product = np.empty(len(pair))
    launch(volume_kernels.products, nodes, tangent, lists, pair, product)
    gram = np.zeros((4, 4))
    np.add.at(gram, tuple(pair.T), product)
    found = np.zeros_like(expected)
    for i in nodes:
        e = head[i]
        while e >= 0:
            found[chain[e, 0], i] += entries[e]
            e = chain[e, 1]
    np.testing.assert_allclose(found, expected, atol=1e-16)
    np.testing.assert_allclose(gram, np.einsum("knd,lnd->kl", expected, expected), atol=1e-16)
    assert (head[~movable] == volume_kernels.FIXED).all()


@pytest.mark.slow
@pytest.mark.parametrize("touching", [0.0, 0.3])
def test_many_drops_get_their_volumes_as_few_do(touching):
    """Without a matrix of all pairs: a fluid with 800 drops, some of which touch others; one cannot move."""
    rng, drops = np.random.default_rng(0), 800
    pair, product = [], []
    for k in range(1, drops + 1):
        other = k - 1 if rng.random() < touching and k > 1 else 0
        for _ in range(rng.integers(3, 30)):
            g = rng.normal(size=2) * (0.0 if k == 7 else 10.0 ** rng.uniform(-1, 1))
            pair += [(k, k), (k, other), (other, k), (other, other)]
            product += [g @ g, -g @ g, -g @ g, g @ g]
    pair, product = np.array(pair, dtype=np.int32), np.array(product)
    missing = rng.normal(size=drops + 1)
    missing[7] = 0.0
    missing[0] -= missing.sum()
    dense = np.zeros((drops + 1, drops + 1))
    np.add.at(dense, tuple(pair.T), product)
    found = volumes.factors(pair, product, missing)
    np.testing.assert_allclose(dense @ found, missing, atol=1e-9 * np.abs(missing).max())
    exact = np.linalg.lstsq(dense, missing, rcond=1e-10)[0]
    apart = (found - exact)[np.arange(drops + 1) != 7]
    np.testing.assert_allclose(apart, apart[0], atol=1e-7 * np.abs(exact).max())  # the combination without effect


def test_a_small_shift_is_the_gradients_times_the_factors():
    x, mesh, label, movable = discs()
    wanted = np.bincount(label, weights=mesh.measure)
    wanted[:2] += [1e-9, -1e-9]
    gradient = gradients_by_numpy(x, mesh.cells, label, movable).reshape(4, -1)
    factor = np.linalg.lstsq(gradient @ gradient.T, wanted - np.bincount(label, weights=mesh.measure), rcond=1e-10)[0]
    shift = move_interfaces(x, mesh.cells, label, movable, wanted, 0.01) - x
    np.testing.assert_allclose(shift, (factor @ gradient).reshape(-1, 2), atol=1e-14)


def test_what_is_lost_at_a_place_is_restored_there():
    x, mesh, label, movable = discs()
    outside = np.argmax(np.bincount(label, weights=mesh.measure))
    mesh = volumes.with_components(Mesh(x, mesh.cells, (label != outside).astype(np.int32)), 2)
    volume = np.bincount(mesh.components.label, weights=mesh.measure)
    wanted, place = volume.copy(), np.array([[0.7, 0.9]])
    k = mesh.components.label[np.argmin(np.linalg.norm(x[mesh.cells].mean(axis=1) - [0.7, 0.7], axis=1))]
    wanted[k] += 1e-4
    wanted[np.argmax(volume)] -= 1e-4
    new = volumes.move_interfaces(mesh, volume, wanted, 0.01, places=volumes.Places(place, np.full(len(x), 0.2)))
    np.testing.assert_allclose(np.bincount(mesh.components.label, weights=new.measure), wanted, rtol=1e-9)
    shift = np.linalg.norm(new.position - x, axis=1)
    near = np.linalg.norm(x - place, axis=1) < 0.2
    on = movable & (mesh.components.mark == ON_INTERFACE)
    assert (shift[~near] == 0).all()
    assert (shift[on & near] > 0).all()
    assert 2 < (on & near).sum() < 0.5 * on.sum()


@pytest.mark.parametrize("given", [False, True])
def test_restoring_gives_components_what_they_had(given):
    """The same triangles, distorted at the interfaces: each label gets back what it had, or what is given."""
    x, mesh, label, movable = discs()
    fluid = (label != label[np.argmin(np.abs(x[mesh.cells] - 0.5).sum(axis=(1, 2)))]).astype(np.int32)
    old = Mesh(x, mesh.cells, fluid)
    had, sizes = np.bincount(label, weights=old.measure), np.bincount(fluid, weights=old.measure)
    moved = x + movable[:, None] * np.random.default_rng(4).uniform(-0.003, 0.003, x.shape)
    new, areas = Mesh(moved, mesh.cells, fluid), simplex_measure(moved, mesh.cells)
    still = np.zeros(len(x), dtype=bool)
    new = restore_volumes(new, old, areas, still, sizes if given else None, 0.01, 2)
    y = new.position
    kept = np.bincount(label, weights=simplex_measure(y, mesh.cells))
    np.testing.assert_allclose(kept, had if given else np.bincount(label, weights=areas), rtol=1e-9)
    np.testing.assert_array_equal(new.measure, simplex_measure(y, mesh.cells))
    assert np.array_equal(y, moved) != given


def test_where_nothing_may_move_nothing_does():
    x, mesh, label, movable = discs()
    np.testing.assert_array_equal(move_interfaces(x, mesh.cells, label, movable & False, np.ones(4), 1.0), x)


def contacts_by_numpy(mesh, slides):
    """`volumes.sliding_contacts`, particle by particle: those that may move, and the directions of their walls."""
    found = {}
    for i in np.flatnonzero(slides & (mesh.components.mark == (ON_INTERFACE | ON_HULL))).tolist():
        walls, interfaces = [], []
        for t, k in np.argwhere((mesh.cells == i).any(axis=1)[:, None] & (mesh.cells != i)).tolist():
            one, other = mesh.cells[t, (k + 1) % 3], mesh.cells[t, (k + 2) % 3]  # an edge at i, opposite corner k
            across, edge = mesh.neighbours[t, k], mesh.position[other] - mesh.position[one]
            if across < 0:
                walls.append(edge)
            elif mesh.fluid[across] != mesh.fluid[t]:
                interfaces.append(edge / np.linalg.norm(edge))
        total = np.sum(walls, axis=0)
        along = total / np.linalg.norm(total)
        straight = np.linalg.norm(total) > (1 - 1e-12) * sum(np.linalg.norm(edge) for edge in walls)
        if straight and all(abs(edge @ along) <= np.cos(volumes.STEEP) for edge in interfaces):
            found[i] = along
    return found


def test_contacts_that_slide_are_those_of_numpy():
    """At corners, and where interfaces are flat, there are none."""
    n, rng = 16, np.random.default_rng(6)
    x = np.stack(np.meshgrid(np.arange(n), np.arange(n)), axis=-1).reshape(-1, 2) / (n - 1.0)
    wall = (x == 0).any(axis=1) | (x == 1).any(axis=1)
    x[~wall] += rng.uniform(-0.4, 0.4, (np.count_nonzero(~wall), 2)) / n
    mesh = triangulate(x, wall, 1 / (n - 1))
    mesh = with_components(Mesh(x, mesh.cells, rng.integers(0, 2, len(mesh.cells), dtype=np.int32)), 2)
    slides = rng.random(len(x)) < 0.8
    nodes, along, near = volumes.sliding_contacts(mesh, slides)
    expected = contacts_by_numpy(mesh, slides)
    at = slides & (mesh.components.mark == (ON_INTERFACE | ON_HULL))
    assert 3 < len(expected) < at.sum()
    assert nodes.tolist() == sorted(expected)
    np.testing.assert_allclose(along, [expected[i] for i in nodes.tolist()], rtol=1e-12, atol=1e-15)
    np.testing.assert_array_equal(near, np.flatnonzero(at[mesh.cells].any(axis=1)))


@pytest.mark.parametrize("slips", [True, False])
def test_an_interface_that_ends_on_walls_that_slip_moves_as_a_whole(slips):
    """All of it by one distance, contacts too, which stay on their walls; on others they stay where they are."""
    n = 9
    x = np.stack(np.meshgrid(np.arange(n), np.arange(n)), axis=-1).reshape(-1, 2) / (n - 1.0)
    mesh = triangulate(x, (x == 0).any(axis=1) | (x == 1).any(axis=1), 1 / (n - 1))
    fluid = (x[mesh.cells].mean(axis=1)[:, 1] > 0.5).astype(np.int32)
    mesh = volumes.with_components(Mesh(x, mesh.cells, fluid), 2)
    lower = mesh.measure[fluid == 0].sum()
    slides = np.isin(x[:, 0], (0, 1)) & (x[:, 1] > 0) & (x[:, 1] < 1)
    wanted = np.array([lower + 1e-3, 1 - lower - 1e-3])[mesh.components.fluid]
    volume = np.array([lower, 1 - lower])[mesh.components.fluid]
    moved = volumes.move_interfaces(mesh, volume, wanted, 0.01, slides if slips else None)
    assert moved.measure[fluid == 0].sum() == pytest.approx(lower + 1e-3, abs=1e-14)
    shift = moved.position - x
    interface = x[:, 1] == 0.5
    contacts = interface & slides
    assert contacts.sum() == 2
    assert (shift[~interface] == 0).all()
    if slips:
        np.testing.assert_allclose(shift[interface], np.tile([0, 1e-3], (n, 1)), atol=1e-14)
    assert (shift[contacts] == 0).all() == (not slips)
    assert (shift[slides, 0] == 0).all()
