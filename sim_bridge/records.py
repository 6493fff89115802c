"""Records for kernels: arrays whose elements have named fields.

A kernel reads and writes `support.load` instead of `supports[i, 2]`. numba compiles both to the
same machine code.
"""

from __future__ import annotations

from dataclasses import astuple, is_dataclass
from functools import lru_cache
from typing import Any, get_type_hints

import numpy as np
from numpy.typing import NDArray

Records = NDArray[np.void]  # array (n,) of records; a kernel gets one record as records[i]


def record(values: Any) -> Records:
    """Return an array (1,) of one record with the values of a dataclass instance.

    Each call of a kernel takes numba 0.1 us for such an array, but 5 us for the record alone or for
    a NamedTuple of 30 numbers. Fields that are dataclass instances become records in the record.
    """
    kind: Any = type(values)
    return np.array([astuple(values)], dtype=record_type(kind))


# Numba recognises the same dtype object at once, but an equal one in 2 us.
@lru_cache(maxsize=None)
def record_type(dataclass: Any) -> np.dtype[np.void]:
    """Return the dtype of a dataclass's records, whose numbers are float64."""
    members: Any = []
    for name, field_type in get_type_hints(dataclass).items():
        is_nested = is_dataclass(field_type)
        members.append((name, record_type(field_type) if is_nested else np.float64))
    dtype: np.dtype[np.void] = np.dtype(members, align=True)
    return dtype
