"""Test of the recorded drive in tests/data, which CONTRIBUTING names to try `./applr why` on."""

import json

import pytest

from tests.support.stopped_drive import BAG, PARAMETER, ROBOT, SPOILT_VALUE
from training.why import __main__ as why

LARGEST_BYTES = 300_000  # Each clone of the repository has the bag.


@pytest.mark.heavy
def test_the_parameter_that_was_spoilt_is_the_first_guess(capsys):
    assert BAG.stat().st_size < LARGEST_BYTES
    assert why.main([str(BAG), "--robot", ROBOT, "--quick", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["reproduced"] == 1.0
    assert [event["kind"] for event in answer["events"]] == ["stood"]
    # The robot's own value, not the default
    assert answer["alternatives"][0].startswith(f"{PARAMETER} {SPOILT_VALUE} -> 0.02: ")
