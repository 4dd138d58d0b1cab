"""Origins of fitted models compared: arrays and a nan are equal to themselves."""

import numpy as np


def assert_same_origin(one, two):
    """Every field, those of the long record one by one."""
    first, second = ({**vars(o), "long_record": o.long_record and vars(o.long_record)} for o in (one, two))
    np.testing.assert_equal(first, second)
