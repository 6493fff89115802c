"""Reader of arrays in the safetensors format, which cannot execute code."""

from __future__ import annotations

import json
from typing import Dict, Tuple

import numpy as np
import safetensors
import safetensors.numpy

from applr_ros1.common.arrays import Data
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import reading

LENGTH_BYTES = 8  # size of the header's length at the beginning of a file, little-endian


def unpack(data: bytes, name: str) -> Tuple[Dict[str, Data], Dict[str, str]]:
    """Return (tensors, metadata) of safetensors bytes from the file `name`.

    Raises FileError if the bytes are invalid, or a number is not finite.
    """
    with reading(name):
        tensors = safetensors.numpy.load(data)
        # load() has checked the header but returns no metadata.
        length = int.from_bytes(data[:LENGTH_BYTES], "little")
        header = json.loads(data[LENGTH_BYTES : LENGTH_BYTES + length])
        for tensor_name, tensor in tensors.items():
            if not np.isfinite(tensor).all():
                problem = f"tensor {tensor_name} has NaN or infinite numbers"
                raise ApplrError(f"{problem}: give a file with finite numbers alone")
        return tensors, header.get("__metadata__") or {}
