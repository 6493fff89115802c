"""Short names of array types, for signatures of kernels, and the nearest of ascending numbers."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]  # array of any shape
Array32 = NDArray[np.float32]
Ints = NDArray[np.int64]  # array of indices or counts, of any shape
Data = np.ndarray  # array of any type and shape


def nearest_rows(stamps: Array, times: Array) -> Ints:
    """Return the indices (k,) of the stamps (n,) [s] that are nearest to times (k,) [s].

    The stamps ascend. Of two equally near ones, the earlier counts.
    """
    if len(stamps) == 1:
        return np.zeros(len(times), int)
    # The stamps on both sides of each time; beyond the ends, the two last ones
    later_rows = np.clip(np.searchsorted(stamps, times), 1, len(stamps) - 1)
    earlier_rows = later_rows - 1
    is_earlier_nearer = times - stamps[earlier_rows] <= stamps[later_rows] - times
    return np.where(is_earlier_nearer, earlier_rows, later_rows)
