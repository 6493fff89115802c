"""Reader of arrays in the safetensors format, which cannot execute code."""

from __future__ import annotations

import json
from typing import Dict, Tuple

import numpy as np
import safetensors
import safetensors.numpy

from applr_ros1.common.errors import ApplrError, reason


def unpack(data: bytes, name: str) -> Tuple[Dict[str, np.ndarray], Dict[str, str]]:
    """Return (tensors, metadata) of safetensors bytes from the file `name`. Raise ApplrError if they are invalid."""
    try:
        tensors = safetensors.numpy.load(data)
    except safetensors.SafetensorError as problem:
        raise ApplrError(f"{name}: cut short, or no safetensors file ({reason(problem)}); copy it again") from None
    header = json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])
    return tensors, header.get("__metadata__") or {}
