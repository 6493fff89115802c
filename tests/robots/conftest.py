"""Descriptions are checked here; tests/training/tuning/test_open_floor.py drives on open floor."""

import pytest

from training import check_robot


@pytest.fixture(autouse=True)
def undriven(monkeypatch):
    """A check that ends where the drive on open floor begins."""
    monkeypatch.setattr(check_robot.open_floor, "try_out", lambda robot: (True, []))
