"""Arrays in safetensors bytes: read with bounds, nothing executed, and a checksum over them."""

from __future__ import annotations

import hashlib
import json
from typing import Dict, Mapping, Tuple

import numpy as np
import safetensors
import safetensors.numpy

from applr_ros1.common.errors import reason
from applr_ros1.common.files import StorageError

MAX_HEADER_BYTES = 2**20
PICKLES = (b"PK", b"\x80\x02", b"\x80\x03", b"\x80\x04", b"\x80\x05")


def unpack(data: bytes, name: str) -> Tuple[Dict[str, np.ndarray], Dict[str, str]]:
    """Return (tensors, metadata) of safetensors bytes whose header is bounded. Nothing is executed.

    Raises StorageError, one line that begins with `name`.
    """
    if data[:2] in PICKLES and data[8:9] != b"{":  # a header can be of 1152 bytes, whose length begins as a pickle does
        raise StorageError(f"{name}: a pickle, not a safetensors file; nothing of it was executed")
    if len(data) < 10:
        raise StorageError(f"{name}: truncated ({len(data)} bytes); copy it again")
    length = int.from_bytes(data[:8], "little")
    if length > MAX_HEADER_BYTES:
        raise StorageError(f"{name}: not a safetensors file (its header would be {length} bytes); give another one")
    try:
        header = json.loads(data[8 : 8 + length].decode("utf-8")).get("__metadata__") or {}
        return safetensors.numpy.load(data), {str(key): str(text) for key, text in header.items()}
    except (safetensors.SafetensorError, ValueError, AttributeError, KeyError, TypeError, RecursionError) as problem:
        raise StorageError(
            f"{name}: truncated or damaged safetensors data ({reason(problem)}); copy it again"
        ) from None


def checksum(weights: Mapping[str, np.ndarray], metadata: Mapping[str, str]) -> str:
    """sha256 (hex) over names, shapes, types and bytes of the tensors and over the metadata but for their "sha256"."""
    digest = hashlib.sha256()
    for name in sorted(weights):
        value = np.ascontiguousarray(weights[name])
        digest.update(f"{name} {value.shape} {value.dtype.name}\n".encode())
        digest.update(value.tobytes())
    for key in sorted(set(metadata) - {"sha256"}):
        digest.update(f"{key} {metadata[key]}\n".encode())
    return digest.hexdigest()
