"""NumPy archives (.npz) from bytes, with a bound on what they unpack to. Nothing is unpickled.

numpy.load would unpack a few kilobytes to any size, and allocates what an array's header claims.
"""

from __future__ import annotations

import io
import zipfile
import zlib
from typing import Dict, Type

import numpy as np

from applr_ros1.common.errors import ApplrError, reason

MAX_ARRAYS = 100


def unpack_npz(data: bytes, name: str, limit: int, error: Type[ApplrError]) -> Dict[str, np.ndarray]:
    """The arrays in the bytes of an .npz file.

    Args:
        data: The file's content.
        name: What the error begins with.
        limit: Bytes of all arrays together, unpacked.
        error: The exception to raise, with one line.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = archive.infolist()
            size = sum(member.file_size for member in members)
            if size > limit or len(members) > MAX_ARRAYS:
                raise error(
                    "%s: %d arrays of %d bytes unpacked are too many; %d arrays of %d bytes are read"
                    % (name, len(members), size, MAX_ARRAYS, limit)
                )
            # zipfile bounds what it unpacks by the size above for these two only
            if any(member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) for member in members):
                raise error("%s: an archive that numpy.savez did not write; give another file" % name)
            return {
                member.filename[: -len(".npy")]: np.lib.format.read_array(
                    io.BytesIO(archive.read(member)), allow_pickle=False
                )
                for member in members
                if member.filename.endswith(".npy")
            }
    except error:
        raise
    except (
        ValueError,
        OSError,
        EOFError,
        MemoryError,
        OverflowError,
        NotImplementedError,
        RuntimeError,
        RecursionError,
        zlib.error,
        zipfile.BadZipFile,
    ) as problem:
        raise error("%s: not an .npz archive, or damaged (%s)" % (name, reason(problem))) from None
