"""Union-find (disjoint sets) in kernels.

``parent`` (N,) links every item to another one of its set; the root of a set is its own parent. See R. E. Tarjan,
J. van Leeuwen, Worst-case analysis of set union algorithms, J. ACM 31, 1984.
"""

import taichi as ti


@ti.func
def find_root(parent: ti.template(), i):  # type: ignore[no-untyped-def]
    """Root of the set that item ``i`` belongs to, with path halving; serial."""
    r = i
    while parent[r] != r:
        parent[r] = parent[parent[r]]
        r = parent[r]
    return r
