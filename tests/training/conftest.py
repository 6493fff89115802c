"""Fixtures of several rooms of training."""

import pytest


@pytest.fixture
def bag_path(tmp_path):
    """Return the path of the bag that a test writes."""
    return tmp_path / "a.bag"
