"""The 300 built-in worlds and their split.

`worlds.loading` reads them from data/builtin.npz, 23 kB of packed bits; `python -m worlds.builtin` makes that file anew
from the generator, and a test compares.
"""

from __future__ import annotations

import argparse
import functools
import io
import os
from typing import Dict, Sequence, Tuple

import numpy as np

from applr_ros1.common import files

from . import barn_grid, generator
from .world import World

FILE = os.path.join(os.path.dirname(os.path.abspath(__file__)), "data", "builtin.npz")

# fmt: off
TEST = (  # the official test numbers of BARN
    0, 8, 17, 19, 27, 32, 41, 47, 48, 57, 64, 69, 76, 78, 88, 93, 100, 104, 112, 118, 123, 129, 133, 138, 144,
    150, 159, 163, 168, 175, 184, 189, 193, 201, 208, 214, 218, 226, 229, 237, 240, 246, 256, 258, 265, 270, 277, 284,
    290, 294,
)
# fmt: on
TRAIN = tuple(n for n in range(generator.COUNT) if n not in TEST)
VALIDATION = TRAIN[4::8]  # training worlds set aside to choose among actors, variants and settings
LEARN = tuple(n for n in TRAIN if n not in VALIDATION)
SPLITS = {"train": TRAIN, "test": TEST, "validation": VALIDATION, "learn": LEARN}


def world(number: int) -> World:
    """World `number` (0 to 299) of the built-in ones."""
    filled, path = fields()[number]
    return barn_grid.make_world(f"generated:{number}", filled, path)


@functools.lru_cache(maxsize=1)
def fields() -> Dict[int, Tuple[np.ndarray, np.ndarray]]:
    """All built-in worlds: {number: (filled (30, 30) bool, path (k, 2) int64 cells)}."""
    with np.load(FILE, allow_pickle=False) as data:
        bits, ends, cells = data["filled"], data["path_ends"], data["path_cells"]
    shape = (generator.COUNT, barn_grid.ROWS, barn_grid.COLS)
    filled = np.unpackbits(bits, count=int(np.prod(shape))).reshape(shape).astype(bool)
    paths = np.split(cells.astype(np.int64).reshape(-1, 2), ends[:-1])
    return {n: (filled[n], paths[n]) for n in range(generator.COUNT)}


def pack(worlds: Sequence[Tuple[np.ndarray, np.ndarray]]) -> bytes:
    """Bytes of the data file for 300 pairs (filled, path), in order."""
    filled = np.array([f for f, _ in worlds], dtype=bool)
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer,
        filled=np.packbits(filled),
        path_cells=np.concatenate([p for _, p in worlds]).astype(np.uint8),
        path_ends=np.cumsum([len(p) for _, p in worlds]).astype(np.int32),
    )
    return buffer.getvalue()


def main() -> None:
    """Generate the 300 worlds and write the data file."""
    argparse.ArgumentParser(
        prog="python -m worlds.builtin",
        description="Makes the 300 built-in worlds again and writes them to worlds/data/builtin.npz.",
    ).parse_args()
    data = pack([generator.generate_field(n) for n in range(generator.COUNT)])
    os.makedirs(os.path.dirname(FILE), exist_ok=True)
    files.write_bytes(FILE, data)
    print(f"{FILE}: {generator.COUNT} worlds, {len(data)} bytes")


if __name__ == "__main__":
    main()
