"""Tests of the rules of what a reason is, with one generator of drives.

What was not seen is not said, whatever else happens: in each situation a planted cause is named, or
what is known without what the situation hides.
"""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.planted_drives import CAUSES, SITUATIONS, planted, said_of
from tests.support.seeds import examples


@pytest.mark.parametrize("situation", SITUATIONS)
def test_no_situation_turns_a_cause_into_another(situation):
    for cause in CAUSES:
        said = said_of(planted(cause, situation, seed=0))
        assert said.verdict(cause, situation) != "wrong", (cause, said)


@examples(100)
@given(st.sampled_from(list(CAUSES)), st.sampled_from(SITUATIONS), st.integers(1, 10_000))
def test_a_cause_is_named_at_any_speed_and_between_any_walls(cause, situation, seed):
    said = said_of(planted(cause, situation, seed))
    assert said.verdict(cause, situation) != "wrong", said


def test_a_cause_without_a_situation_is_named():
    for cause in CAUSES:
        assert said_of(planted(cause, "pure", seed=0)).verdict(cause, "pure") == "right", cause
