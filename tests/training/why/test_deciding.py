"""Tests of drives in which the robot's policy decided: it decides again in simulation, what it sets
is no candidate, and an obstacle range that is too short for it is found.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from applr_ros1 import robots
from applr_ros1.drives import simulate
from applr_ros1.drives.end_rules import Rules
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.parameters.settings import Change
from applr_ros1.planner.variant import CPP_LIKE
from applr_ros1.policy import methods
from applr_ros1.policy.pilot import Pilot
from applr_ros1.stack.simulated import SimulatedRobot
from applr_ros1.stack.stack import Stack
from applr_ros1.why.answer import answer_of
from applr_ros1.why.diagnosis import Diagnosis, diagnose
from applr_ros1.why.events import Event
from applr_ros1.why.recording import Recording
from applr_ros1.why.replay import replay_of
from sim_bridge.kinematic_simulator import KinematicSimulator
from training.attempts import trials as whole_drives
from training.why import remedies
from training.why.deciding import decides
from training.why.driven import with_trials
from training.why.remedies import candidates, driven_trials, possible_guesses
from training.workers.pool import Pool
from worlds import Course, World
from worlds.world import NO_CIRCLE_M

JACKAL = robots.JACKAL
PLANNER = "TrajectoryPlannerROS"


def dead_end():
    """Return a world with a dead end ahead, 1.2 m wide and 3.7 m deep, on open floor."""
    walls = [(-0.6, 3.35, 0.0, 0.1, 3.7), (0.6, 3.35, 0.0, 0.1, 3.7), (0.0, 5.2, 0.0, 1.3, 0.1)]
    course = Course(
        start=(0.0, 0.0, np.pi / 2),
        goal=(0.0, 9.0, np.pi / 2),
        finish_y=None,
        goal_tolerance=NO_CIRCLE_M,
        path=np.array([(0.0, 0.0), (0.0, 9.0)]),
        planner_ends=True,
    )
    return World("dead end", np.zeros((0, 3)), np.array(walls), course)


@pytest.fixture(scope="module")
def recorded():
    """Return a replay of the policy's drive with the files' obstacle range of 2.5 m."""
    move_base = MoveBase(JACKAL.driven_parameters(), planner=CPP_LIKE, seed=1)
    stack = Stack(JACKAL, move_base, monitor=True)
    drive = simulate.drive(
        SimulatedRobot(KinematicSimulator(JACKAL), stack),
        dead_end(),
        1,
        Pilot(methods.make("applr", JACKAL), JACKAL),
        Rules(limit=30.0),
        record=True,
    )
    return replay_of(Recording.of(drive, JACKAL))


def test_the_decisions_of_the_robots_policy_are_known(recorded):
    recording = recorded.recording
    assert decides(recording)

    # The same drive with decisions of which half are a little different
    decisions = []
    for number, decision in enumerate(recording.drive.decisions):
        after = dict(decision.after)
        if number % 2 == 0:
            after["max_vel_theta"] -= 0.1
        decisions.append(decision._replace(after=after))
    others = replace(recording, drive=replace(recording.drive, decisions=decisions))
    assert not decides(others)


def test_without_decisions_inputs_or_a_policy_nobody_decides(recorded):
    recording = recorded.recording
    undriven = replace(recording, drive=replace(recording.drive, decisions=[]))
    assert not decides(undriven)

    blind = [decision._replace(seen=None) for decision in recording.drive.decisions]
    assert not decides(replace(recording, drive=replace(recording.drive, decisions=blind)))

    burger = robots.load("turtlebot3_burger")
    assert not decides(replace(recording, robot=burger))


def guess_of(name, value):
    """Return a guess that changes a value of the local planner."""
    change = Change(PLANNER, name, 1.0, value)
    return SimpleNamespace(change=change, changes=(change,))


def test_what_the_policy_sets_is_neither_tried_nor_guessed(recorded, monkeypatch):
    live = [guess_of("sim_time", 3.0), guess_of("acc_lim_theta", 3.2)]
    ranked = []

    def guesses_of(diagnosis, attempts):
        ranked.append({changes[0].name for changes in attempts})
        return live

    monkeypatch.setattr(remedies, "guesses_of", guesses_of)
    event = Event("crept", 1.0, 12.0, (0.0, 0.3))
    possible_guesses(Diagnosis.of(recorded, [event]))

    tried_names = set()
    for candidate in candidates(JACKAL, live, decides(recorded.recording)):
        tried_names.update(candidate.names)
    assert {"acc_lim_theta", "obstacle_range"} <= tried_names
    assert not tried_names & {"sim_time", "inflation_radius", "footprint_padding"}

    # Without the policy, all of them are tried.
    undriven = replace(recorded.drive, decisions=[])
    other_replay = replace(recorded, recording=replace(recorded.recording, drive=undriven))
    possible_guesses(Diagnosis.of(other_replay, [event]))
    with_policy, without_policy = ranked
    assert without_policy - with_policy >= {"sim_time", "inflation_radius"}
    assert "acc_lim_theta" in with_policy
    tried_names = set()
    for candidate in candidates(JACKAL, live, decides(other_replay.recording)):
        tried_names.update(candidate.names)
    assert {"acc_lim_theta", "sim_time", "footprint_padding"} <= tried_names


@pytest.mark.slow
def test_a_dead_end_that_the_policy_entered_unseen_is_left_out_with_the_range_it_was_made_for(
    recorded, monkeypatch
):
    # One seed instead of two chooses: these drives are simulated.
    monkeypatch.setattr(whole_drives, "CHOOSING", (1,))
    monkeypatch.setattr(whole_drives, "CONFIRMING", (2, 3, 4, 5, 6, 7))
    diagnosis = diagnose(recorded)

    with Pool(0) as pool:
        trials = driven_trials(diagnosis, [], pool)

    assert str(trials.remedy.candidate) == (
        "obstacle_range 2.5 -> 5, raytrace_range 3 -> 5.5 in both costmaps"
    )
    assert trials.remedy.seconds < 0.6 * trials.recorded.seconds
    certainty = with_trials(answer_of(diagnosis), trials).sure
    assert certainty.endswith(
        "simulated with its policy, which made the recorded decisions, the robot stops there, too."
    )
