"""Tests of the answers of the black box: what is seen from outside first, then the planner's."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from applr_ros1.common.errors import ApplrError
from applr_ros1.drives.columns import TopicNames
from applr_ros1.drives.drive import Verdicts
from applr_ros1.robots import JACKAL
from applr_ros1.why.black_box.answering import answers_of
from applr_ros1.why.black_box.description import DescribedRobot, driving
from applr_ros1.why.black_box.stops import HELD
from applr_ros1.why.diagnosis import POOR
from applr_ros1.why.events import SAVED, RobotStop
from tests.support.drives import before_a_monitor, until
from tests.support.raw_messages import description_of, deserialize, raw_messages
from tests.support.replays import PLANNER, spoilt_drive

BEGIN_S = 1.0  # time at which a written bag begins [s]


@pytest.fixture(scope="module")
def spoilt():
    """Return a robot whose planner samples only 0.1 m/s, and a drive of twelve seconds."""
    return spoilt_drive()


def answers(
    path, robot, drive, stop=None, described=None, unpublished=(), changed=lambda messages: None
):
    """Return the answers to the stop of a drive.

    Args:
        path: Path for a bag.
        robot: Robot that drove.
        drive: The drive.
        stop: The stop. Default: from 2 to 8 s.
        described: Robot that is described instead.
        unpublished: Topics of its sensors that nobody publishes.
        changed: Function that changes the list of messages.
    """
    messages = raw_messages(path, drive, robot=robot)
    changed(messages)
    # The simulated drives count cells, as this package's stack does.
    described = described or driving(robot, robot.driven_parameters())
    described_robot = DescribedRobot(described, TopicNames.of(robot), True, unpublished)
    stop = stop or RobotStop("crept", BEGIN_S + 2.0, BEGIN_S + 8.0, (0.5, 0.25))
    description = description_of(described_robot, messages[0].time, stop)
    box_answers = answers_of([description, *messages], deserialize)
    return [SimpleNamespace(**answer.message()) for answer in box_answers]


@pytest.mark.heavy
def test_the_answer_has_the_planners_reason_and_a_guess(spoilt, tmp_path):
    robot, drive = spoilt
    first_answer, reason, answer = answers(tmp_path / "drive.bag", robot, drive)
    # The guess takes as long as everything else.
    assert (reason.reason, reason.parameter) == (answer.reason, "")
    # From outside nothing is wrong.
    assert (first_answer.kind, first_answer.reason) == ("crept", "")
    assert first_answer.reproduced == 0.0
    assert (
        answer.reason == "no command faster than 0.10 m/s is sampled (vx_samples 1, acc_lim_x 10)"
    )
    assert answer.reproduced > 0.95
    assert answer.parameter == f"{PLANNER}/vx_samples"
    assert (answer.before, answer.after) == (1, 2)
    assert answer.begin == pytest.approx(BEGIN_S, abs=0.1)
    assert answer.frame == "odom"
    words = answer.sentence
    assert words.startswith("the robot crept for 12 s at (")
    assert "because no command faster than" in words
    assert words.endswith(f"; the replay's guess: {PLANNER}/vx_samples 1 -> 2")


@pytest.mark.heavy
def test_a_reason_from_outside_needs_no_replay_and_has_no_guess(spoilt, tmp_path):
    robot, drive = spoilt
    has_scan = drive.scans.time < 4.0
    silent = replace(drive, scans=drive.scans.part(slice(0, int(has_scan.sum()))))
    (answer,) = answers(tmp_path / "silent.bag", robot, silent)
    assert answer.reason == "there was no scan for 8.0 s"
    assert (answer.parameter, answer.reproduced) == ("", 0.0)

    verdicts = Verdicts(np.array([0.0]), ["stop"], ["a wall"])
    held = replace(before_a_monitor(drive), verdicts=verdicts)
    stop = RobotStop(HELD, BEGIN_S + 2.0, BEGIN_S + 8.0, (0.5, 0.25))
    (answer,) = answers(tmp_path / "held.bag", robot, held, stop)
    assert answer.reason == "the collision monitor blocks 100 % of the commanded motion: a wall"
    # What was said when the stop was found is corrected.
    first_words = f"the robot, which {HELD} at first, crept for 12 s at "
    assert answer.sentence.startswith(first_words)


def test_messages_that_cannot_be_unpacked_are_left_out_and_counted(spoilt, tmp_path, caplog):
    def cut(messages):
        """Cut two messages of odometry and the first plan."""
        for topic, count in (("/odometry/filtered", 2), (f"/move_base/{PLANNER}/global_plan", 1)):
            numbers = [n for n, entry in enumerate(messages) if entry.publication.topic == topic]
            for number in numbers[:count]:
                messages[number] = messages[number]._replace(data=messages[number].data[:20])

    robot, drive = spoilt
    silent = replace(drive, scans=drive.scans.part(slice(0, 40)))
    (answer,) = answers(tmp_path / "cut.bag", robot, silent, changed=cut)
    assert answer.reason.startswith("there was no scan for")
    (line,) = [record.message for record in caplog.records if record.levelname == "WARNING"]
    assert line.startswith("stop: messages cut or damaged, left out: ")
    assert "2 on /odometry/filtered" in line
    assert f"1 on /move_base/{PLANNER}/global_plan" in line


@pytest.mark.parametrize(
    ("missing", "unpublished", "reason"),
    [
        ("odometry", (), "there is no odometry on /odometry/filtered"),
        ("odometry", ("/odometry/filtered",), "nobody publishes /odometry/filtered"),
        ("scans", ("/front/scan",), "nobody publishes /front/scan"),
    ],
)
def test_of_a_stop_without_a_sensor_its_topic_is_named(
    missing, unpublished, reason, spoilt, tmp_path
):
    robot, drive = spoilt
    # The monitor holds a robot that sees nothing.
    verdicts = Verdicts(np.array([0.0]), ["stop"], ["no scan"])
    blind = replace(until(drive, 9.0), verdicts=verdicts, **{missing: None})
    (answer,) = answers(tmp_path / "drive.bag", robot, blind, unpublished=unpublished)
    assert answer.reason == reason


def test_what_hinders_the_replay_is_a_note(spoilt, tmp_path):
    robot, drive = spoilt
    without_plans = replace(drive, plans=None, routes=None)
    _, answer = answers(tmp_path / "drive.bag", robot, without_plans)
    assert "no messages on /move_base/TrajectoryPlannerROS/global_plan" in answer.note
    assert answer.kind == "crept"


@pytest.mark.heavy
def test_a_replay_that_reproduces_little_is_called_so_and_gives_no_guess(spoilt, tmp_path):
    # Given: a robot whose planner samples fewer speeds than its description says
    _, drive = spoilt
    *_, answer = answers(tmp_path / "drive.bag", JACKAL, until(drive, 4.0))
    # Then: the threshold is the one of `why`, and no parameter is to be tried
    assert answer.reproduced < POOR
    assert answer.note.startswith("only ")
    assert "of the planner's commands are reproduced, so its reasons are not to" in answer.sentence
    assert answer.parameter == ""


@pytest.mark.heavy
def test_a_moment_that_is_no_event_is_explained_by_itself(spoilt, tmp_path):
    robot, drive = spoilt
    no_event = replace(drive, goals=[goal._replace(end=0.2) for goal in drive.goals])
    stop = RobotStop("gave up its goal", BEGIN_S + 5.0, BEGIN_S + 5.0, (0.5, 0.25))
    *_, answer = answers(tmp_path / "gave_up.bag", robot, no_event, stop)
    assert answer.kind == "gave up its goal"
    assert answer.reason.startswith("no command faster than")
    assert (answer.x, answer.y) == (0.5, 0.25)


def test_somebody_who_asks_to_save_before_any_stop_is_told_so(spoilt, tmp_path):
    robot, drive = spoilt
    no_event = replace(drive, goals=[goal._replace(end=0.2) for goal in drive.goals])
    stop = RobotStop(SAVED, BEGIN_S + 5.0, BEGIN_S + 5.0, (0.5, 0.25))
    (answer,) = answers(tmp_path / "saved.bag", robot, no_event, stop)
    assert answer.sentence == "the robot was asked to save at (0.50, 0.25) (it has not stopped)"


def test_messages_without_a_description_are_refused(spoilt, tmp_path):
    _, drive = spoilt
    messages = raw_messages(tmp_path / "drive.bag", drive)
    with pytest.raises(ApplrError, match="no message on /black_box/parameters"):
        list(answers_of(messages, deserialize))


@pytest.mark.slow
def test_the_unit_of_the_distance_biases_is_that_of_the_running_move_base(spoilt, tmp_path):
    robot, drive = spoilt
    *_, answer_by_cells = answers(tmp_path / "cells.bag", robot, drive)
    assert robot.parameters()[PLANNER]["meter_scoring"]
    in_metres = driving(robot, robot.parameters())
    *_, answer_by_metres = answers(tmp_path / "metres.bag", robot, drive, described=in_metres)
    # Per metre, the distances weigh less, so that other samples win on the way ahead.
    assert (answer_by_cells.after, answer_by_metres.after) == (2, 20)
