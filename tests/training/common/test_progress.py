"""Long work is announced, quick work is not."""

import time

import pytest

from applr_ros1.common.progress import announced


def test_quick_work_is_silent_and_an_error_passes_through():
    lines = []
    with pytest.raises(KeyError), announced("compiling", lines.append, first=5.0):
        raise KeyError
    assert lines == []


def test_work_that_an_error_ended_is_not_called_done():
    lines = []
    with pytest.raises(IndexError), announced("compiling", lines.append, first=0.02):
        [][time.sleep(0.1) or 0]
    assert lines == ["compiling"]


def test_long_work_is_announced_and_never_silent_for_long():
    lines = []
    with announced("compiling kernels (about a minute)", lines.append, first=0.05, every=0.1):
        time.sleep(0.4)
    assert lines[0] == "compiling kernels (about a minute)"
    assert len(lines) in (4, 5, 6)
    assert lines[1].startswith("still compiling kernels: ")
    assert lines[-1] == "done compiling kernels: took 0 s"
