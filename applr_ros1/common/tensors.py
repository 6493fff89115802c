"""Reader of arrays in the safetensors format, which cannot execute code."""

from __future__ import annotations

import json
from typing import Dict, Tuple

import numpy as np
import safetensors
import safetensors.numpy

from applr_ros1.common.errors import ApplrError, reason

LENGTH_BYTES = 8  # size of the header's length at the beginning of a file, little-endian


def unpack(data: bytes, name: str) -> Tuple[Dict[str, np.ndarray], Dict[str, str]]:
    """Return (tensors, metadata) of safetensors bytes from the file `name`.

    Raises ApplrError if the bytes are invalid.
    """
    try:
        tensors = safetensors.numpy.load(data)
    except safetensors.SafetensorError as problem:
        failure = f"cut short, or no safetensors file ({reason(problem)}); copy it again"
        raise ApplrError(f"{name}: {failure}") from None
    # load() has checked the header but returns no metadata.
    length = int.from_bytes(data[:LENGTH_BYTES], "little")
    header = json.loads(data[LENGTH_BYTES : LENGTH_BYTES + length])
    return tensors, header.get("__metadata__") or {}
