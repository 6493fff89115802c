"""Tests of the rules of what a reason is, with one generator of drives.

What was not seen is not said, whatever else happens: in each situation a planted cause is named, or
what is known without what the situation hides.
"""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from applr_ros1.drives.drive import Changes, Plans
from applr_ros1.robots import JACKAL
from applr_ros1.why.answer import GUESSED, REPLAYED, answer_of
from applr_ros1.why.costmap_sources import sources_in
from applr_ros1.why.diagnosis import diagnose
from applr_ros1.why.fitting import followed_routes
from applr_ros1.why.limits import changes_of, limits_of
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


# -- what is unknown, and what a name is
def test_a_global_plan_that_the_next_followed_one_leaves_is_that_of_another_node():
    def line(x, y):
        return np.array([(x + 0.1 * step, y, 0.0) for step in range(30)])

    routes = Plans(
        np.array([0.0, 1.0, 2.0, 9.0]), [line(0, 0), line(0, 2), np.empty((0, 3)), line(0, 5)]
    )
    followed = Plans(np.array([0.5, 1.5, 2.5]), [line(0, 0)[:9], line(0, 0.2)[:9], line(0, 0)[:9]])
    own = followed_routes(routes, followed)
    # An empty plan, and one that nobody had time to follow, leave nothing.
    assert own.time.tolist() == [0.0, 2.0, 9.0]


def test_updates_of_move_base_itself_and_of_older_nodes_count(sound):
    changes = Changes(
        np.array([1.0, 2.0]),
        ["DWAPlannerROS", ""],
        [
            {"max_rot_vel": 0.4, "min_trans_vel": 0.1, "min_vel_trans": 0.2},
            {"controller_frequency": 4.0},
        ],
    )
    drive = replace(sound.drive, changes=changes)
    (_, _, values), _ = changes_of(drive, JACKAL)
    assert values == {"max_vel_theta": 0.4, "min_vel_trans": 0.2}
    limits = limits_of(drive, drive.odometry, JACKAL, {})
    assert limits.period_at(1.9) == 0.05
    assert limits.period_at(2.0) == 0.25


def test_what_the_local_costmap_sees_beside_its_first_laser_is_known():
    def sources(plugins, **sections):
        tree = {"local_costmap": {"plugins": plugins, **sections}}
        return sources_in(replace(JACKAL.with_parameters(tree, "jackal"), is_running=True))

    scan = {"data_type": "LaserScan", "topic": "scan", "marking": True, "clearing": True}
    depth = {"data_type": "PointCloud2", "topic": "points", "marking": True, "clearing": True}
    obstacles = {"name": "obstacles", "type": "costmap_2d::ObstacleLayer"}
    sonar = {"name": "sonar", "type": "range_sensor_layer::RangeSensorLayer"}
    both = {"observation_sources": "a b", "a": scan, "b": depth}
    assert sources([obstacles, sonar], obstacles=both) == (
        ["scan"],
        ["points (obstacles)", "sonar"],
    )
    assert sources([obstacles], obstacles={"observation_sources": "b", "b": depth}).lasers == []


# -- how sure an answer is
def test_a_reason_of_a_replay_that_explains_little_of_the_event_is_a_guess(replay):
    diagnosis = diagnose(replay)
    assert answer_of(diagnosis).confidence == REPLAYED
    told = diagnosis.told
    # What is reproduced elsewhere proves nothing.
    cycles = [
        replace(cycle, error=1.0) if told.begin <= cycle.at <= told.end else cycle
        for cycle in replay.cycles
    ]
    answer = answer_of(diagnose(replace(replay, cycles=cycles)))
    assert answer.confidence == GUESSED
    assert ", perhaps because " in answer.first_line
    assert "; 0% in this event; only 0% of" in answer.certainty
    assert answer.message()["confidence"] == GUESSED


@pytest.mark.parametrize(("share", "confidence"), [(0.4, GUESSED), (0.6, REPLAYED)])
def test_a_reason_of_a_replay_that_has_a_plan_for_little_of_the_event_is_a_guess(
    replay, share, confidence
):
    told = diagnose(replay).told
    planned_from = told.end - share * told.seconds
    cycles = [cycle for cycle in replay.cycles if cycle.at >= planned_from]
    assert answer_of(diagnose(replace(replay, cycles=cycles))).confidence == confidence
