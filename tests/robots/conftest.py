"""Fixture for checks without driving; tests/training/robot/test_open_floor.py tests the drive on
open floor.
"""

import pytest


@pytest.fixture(autouse=True)
def undriven(monkeypatch):
    """Skip the drive on open floor at the end of a check."""
    try:
        from training.robot import check as check_robot
    except ModuleNotFoundError:
        return  # Python 3.8 has no training, and so no checks.
    monkeypatch.setattr(check_robot.open_floor, "try_out", lambda robot: (True, []))
