"""Table of key frames (movers.csv) from the compiled Gazebo plugins of DynaBARN.

`python -m worlds.dynabarn_plugins plugins/*.so > movers.csv`. A plugin's machine code loads its key
frames as constants, in their order. The code is searched for these instructions and not executed.
"""

from __future__ import annotations

import argparse
import csv
import re
import struct
import sys
from pathlib import Path
from typing import List, Tuple

from applr_ros1.common.errors import ApplrError, run_main
from applr_ros1.common.files import read_bytes, reading

from .dynabarn import COLUMNS
from .world import KeyFrame

# Instructions that load a constant: pxor for zero; movsd and mov with the offset of the constant.
LOAD = re.compile(rb"\x66\x0f\xef\xc0|(?:\xf2\x0f\x10|\x48\x8b)\x05(.{4})", re.DOTALL)
FRAME_SIZE = 7  # constants of a key frame: time, z, y, x and three angles


def key_frames_of(code: bytes) -> Tuple[float, List[KeyFrame]]:
    """Return the length of a plugin's animation [s] and its key frames (time, x, y).

    Args:
        code: machine code of the plugin.

    Raises:
        ApplrError: The code loads no key frames.
    """
    constants = _constants(code)
    # The length is the first constant that is neither 0 nor 1.
    first = 0
    while first < len(constants) and (abs(constants[first]) < 1e-9 or constants[first] == 1.0):
        first += 1
    if first == len(constants):
        raise ApplrError("no key frames in this file: give the plugins of DynaBARN")

    length = constants[first]
    frames = []
    last_time = 0.0
    for begin in range(first + 1, len(constants) - FRAME_SIZE + 1, FRAME_SIZE):
        frame_time, _, y, x = constants[begin : begin + 4]
        if not frame_time >= last_time:
            break  # The times of key frames ascend; other constants follow.
        frames.append((frame_time, x, y))
        last_time = frame_time
    return length, frames


def _constants(code: bytes) -> List[float]:
    """Return the constants that the code loads, in the order of the instructions."""
    constants = []
    for load in LOAD.finditer(code):
        constant = 0.0
        if load[1]:
            # The offset counts from the end of the instruction.
            (offset,) = struct.unpack("<i", load[1])
            place = load.end() + offset
            if 0 < place <= len(code) - 8:
                (constant,) = struct.unpack_from("<d", code, place)
        constants.append(constant)
    return constants


def main() -> int:
    """Print the table. Return exit status 1 if a plugin cannot be read."""
    parser = argparse.ArgumentParser(
        prog="python -m worlds.dynabarn_plugins",
        description="Print the table of key frames of DynaBARN's Gazebo plugins.",
    )
    parser.add_argument("plugins", nargs="+", help="Compiled plugins, such as plugins/*.so.")
    arguments = parser.parse_args()

    def print_table() -> None:
        rows: List[Tuple[object, ...]] = [COLUMNS]
        for path in arguments.plugins:
            with reading(path):
                length, frames = key_frames_of(read_bytes(path))
            for frame_time, x, y in frames:
                rows.append((Path(path).stem, length, 1, frame_time, x, y))
        # Only now, so that an unreadable plugin leaves no partial table
        csv.writer(sys.stdout, lineterminator="\n").writerows(rows)

    return run_main(print_table, "dynabarn_plugins")


if __name__ == "__main__":
    sys.exit(main())
