"""Memory that is kept from step to step."""

import numpy as np

from tipfem.scratch import copied, filled, scratch


def test_the_same_array_is_the_same_memory_again():
    one = scratch("test.kept", (4, 2))
    assert scratch("test.kept", (4, 2)) is one
    assert np.shares_memory(scratch("test.kept", 3, np.int32), one)
    again = scratch("test.kept", (4, 2))
    assert again.shape == (4, 2)
    assert again.dtype == np.float64
    assert np.shares_memory(again, one)
    assert not np.shares_memory(scratch("test.other", (4, 2)), one)
    grown = scratch("test.kept", (40, 2))
    one.fill(1.0)
    grown.fill(2.0)
    assert (one == 1.0).all()


def test_what_is_copied_or_filled_takes_the_place_of_the_last():
    given = np.arange(6.0).reshape(3, 2)
    one = copied(given[:, :1], "test.copied")
    np.testing.assert_array_equal(one, given[:, :1])
    assert one.flags.c_contiguous
    one[:] = -1.0
    assert given[0, 0] == 0.0
    assert copied(np.array([True, False]), "test.mask", np.int32).tolist() == [1, 0]
    assert filled(7, "test.mask", 2, np.int32).tolist() == [7, 7]
