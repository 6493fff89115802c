"""Tests of the table of key frames that is made of DynaBARN's compiled plugins."""

import struct

import pytest

from applr_ros1.common.errors import ApplrError
from worlds.dynabarn_plugins import key_frames_of

ZERO = b"\x66\x0f\xef\xc0"  # pxor xmm0, xmm0
MOVSD = b"\xf2\x0f\x10\x05"  # movsd xmm0, [rip + offset]
LOAD_SIZE = 8  # bytes of a MOVSD with its offset


def machine_code(*constants):
    """Return code that loads the constants, which follow it; zeros come from ZERO."""
    zero_count = constants.count(0.0)
    place = len(ZERO) * zero_count + LOAD_SIZE * (len(constants) - zero_count)
    code = b""
    data = b""
    for constant in constants:
        if constant == 0.0:
            code += ZERO
            continue
        offset = place + len(data) - len(code) - LOAD_SIZE
        code += MOVSD + struct.pack("<i", offset)
        data += struct.pack("<d", constant)
    return code + data


def test_key_frames_are_read_from_the_machine_code_of_a_plugin():
    # Given: constants before the length, two key frames (time, z, y, x, three angles), and others
    code = machine_code(
        *(0.0, 1.0),
        12.5,
        *(0.0, 0.5, 10.0, -0.5, 0.0, 0.0, 0.0),
        *(1.25, 0.5, 9.0, -1.0, 0.0, 0.0, 0.0),
        *(0.25, 7.0, 7.0, 7.0, 7.0, 7.0, 7.0),
    )
    length, frames = key_frames_of(code)
    assert length == 12.5
    assert frames == [(0.0, -0.5, 10.0), (1.25, -1.0, 9.0)]


def test_a_file_without_constants_is_refused():
    with pytest.raises(ApplrError, match="no key frames"):
        key_frames_of(b"#!/bin/sh")
