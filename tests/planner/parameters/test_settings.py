"""Tests of parameter values by server and name, and of changes between them."""

import copy
import math

import pytest

from applr_ros1 import robots
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.parameters.check import complete
from applr_ros1.planner.parameters.settings import Change, Settings

PLANNER = "TrajectoryPlannerROS"
LAYER = "local_costmap/inflater_layer"
SLOWER = Change(PLANNER, "max_vel_x", 0.5, 0.25)
NARROWER = Change(LAYER, "inflation_radius", 1.0, 0.5)


@pytest.fixture
def settings():
    """Return settings of two servers."""
    return Settings({PLANNER: {"max_vel_x": 0.5, "dwa": False}, LAYER: {"inflation_radius": 1.0}})


def test_differences_are_the_changes_that_lead_to_other_settings(settings):
    changed = settings.with_(NARROWER, SLOWER)
    assert settings.differences(changed) == [SLOWER, NARROWER]
    assert settings.with_(*settings.differences(changed)) == changed
    assert settings.differences(settings) == []
    # What these settings do not know is no difference.
    with_unknown = {PLANNER: {"max_vel_x": 0.25, "unknown": 1}, "other": {"x": 1}}
    assert settings.differences(with_unknown) == [SLOWER]


def test_settings_never_change(settings):
    values = {LAYER: {"inflation_radius": 1.0}}
    copied = Settings(values)
    values[LAYER]["inflation_radius"] = 2.0
    assert copied[LAYER]["inflation_radius"] == 1.0
    changed = settings.with_(SLOWER)
    assert settings[PLANNER]["max_vel_x"] == 0.5
    assert changed[PLANNER]["max_vel_x"] == 0.25
    with pytest.raises(TypeError):
        settings[PLANNER]["max_vel_x"] = 0.1


def test_other_values_of_a_server_replace_all_that_it_had(settings):
    narrow = {"inflation_radius": 0.5}
    replaced = settings.replaced(LAYER, narrow)
    assert replaced == {PLANNER: settings[PLANNER], LAYER: narrow}
    assert replaced.only([LAYER]) == {LAYER: narrow}
    narrow["inflation_radius"] = 2.0
    assert replaced[LAYER]["inflation_radius"] == 0.5
    # A copied planner, as in a search, needs no copy of what never changes.
    assert copy.deepcopy(settings) is settings


def test_a_change_in_words():
    assert str(NARROWER) == "inflation_radius 1 -> 0.5"
    assert SLOWER.advice == "set TrajectoryPlannerROS/max_vel_x to 0.25 instead of 0.5"
    # A parameter of move_base itself has no server in its name.
    of_move_base = Change("", "planner_frequency", 0.0, 1.0)
    assert of_move_base.advice == "set planner_frequency to 1 instead of 0"
    assert str(Change("", "base_local_planner", "a/B", "c/D")) == "base_local_planner a/B -> c/D"


@pytest.mark.parametrize(
    ("before", "after", "ratio"),
    [
        (0.5, 0.25, 2.0),
        (0.25, 0.5, 2.0),
        (-0.5, -0.25, 2.0),
        # Another sign, or none
        (-0.5, 0.5, math.inf),
        (0.0, 0.5, math.inf),
        (0.5, 0.0, math.inf),
        # Values without a size
        (False, True, 1.0),
        ("a/B", "c/D", 1.0),
    ],
)
def test_the_departure_is_the_ratio_of_two_values_of_one_sign(before, after, ratio):
    assert Change(PLANNER, "name", before, after).departure == ratio


@pytest.mark.parametrize(
    ("before", "after", "default", "is_away"),
    [
        (2.0, 3.0, 1.0, True),
        (2.0, 1.5, 1.0, False),
        # Beyond the default: nearer than before, as far away, and farther
        (2.0, 0.5, 1.0, False),
        (2.0, 0.0, 1.0, False),
        (2.0, -0.5, 1.0, True),
        # Values without a size
        (True, False, True, False),
        ("a/B", "c/D", "a/B", False),
    ],
)
def test_a_change_leads_away_if_it_ends_farther_from_the_default(before, after, default, is_away):
    assert Change(PLANNER, "name", before, after).leads_away(default) is is_away


@pytest.mark.parametrize("name", robots.NAMES)
def test_a_tree_gives_the_values_with_which_move_base_starts(name):
    tree = robots.load(name).parameters()
    settings = Settings.from_tree(complete(tree))
    move_base = MoveBase(tree)
    assert set(settings) == set(move_base.servers)
    for server, values in settings.items():
        configuration = move_base.configuration(server)
        assert values == {name: configuration[name] for name in values}, server
        # Older names, and a switch, are no values of their own.
        left_out = {"restore_defaults"}
        for parameter in move_base.servers[server].parameters:
            left_out.update(parameter.aliases)
        assert set(configuration) - set(values) <= left_out
