"""Replays that several tests ask, which nobody changes.

Their drives are imported when they are asked for: they come from a module that also writes bags,
for which Python 3.8 is too old.
"""

import pytest


@pytest.fixture(scope="module")
def sound():
    """Return a replay of a drive without a fault."""
    from tests.support.replays import sound_replay

    return sound_replay()


@pytest.fixture(scope="module")
def replay():
    """Return a replay of the drive with the fault."""
    from tests.support.replays import spoilt_replay

    return spoilt_replay()
