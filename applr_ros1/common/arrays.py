"""NumPy archives (.npz) from bytes, with a bound on what they unpack to. Nothing is unpickled."""

from __future__ import annotations

import io
import zipfile
from typing import Dict

import numpy as np

from applr_ros1.common.errors import ApplrError, reason


def unpack_npz(data: bytes, name: str, limit: int) -> Dict[str, np.ndarray]:
    """The arrays in the bytes of an .npz file; ApplrError, which begins with `name`, where there are none.

    limit: bytes of all arrays together, unpacked; numpy.load alone would unpack a few kilobytes to any size.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            size = sum(member.file_size for member in archive.infolist())
        if size <= limit:
            with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
                return {key: array for key, array in arrays.items() if isinstance(array, np.ndarray)}
    except Exception as problem:  # zipfile's, zlib's and numpy's many kinds
        raise ApplrError(f"{name}: not an .npz archive, or damaged ({reason(problem)})") from None
    raise ApplrError(f"{name}: {size} bytes unpacked are too many; {limit} are read")
