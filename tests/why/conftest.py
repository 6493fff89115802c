"""Replays that several tests ask, which nobody changes."""

import pytest

from tests.support.replays import sound_replay, spoilt_replay


@pytest.fixture(scope="module")
def sound():
    """Return a replay of a drive without a fault."""
    return sound_replay()


@pytest.fixture(scope="module")
def replay():
    """Return a replay of the drive with the fault."""
    return spoilt_replay()
