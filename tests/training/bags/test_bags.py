"""Tests of the conversion of ROS 1 and ROS 2 bags to transitions: inputs and decisions of the node,
damaged data.
"""

import os
import shutil
import subprocess
import sys
from collections import Counter
from contextlib import nullcontext, suppress
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer

import worlds
from applr_ros1.common.errors import ApplrError
from applr_ros1.drives.bag import rows_of
from applr_ros1.drives.columns import (
    COLUMNS,
    GAVE_UP,
    PREEMPTED,
    REJECTED,
    SECOND,
    SUCCEEDED,
    Sender,
)
from applr_ros1.drives.drive import Drive as Recorded
from applr_ros1.drives.drive import (
    Goal,
    Motion,
)
from applr_ros1.policy.decision import Context, Seen
from applr_ros1.policy.dimensionless import DIMENSIONLESS
from applr_ros1.policy.encoding import PaperEncoding
from applr_ros1.policy.observation import LAYOUT
from applr_ros1.policy.parameter_space import SPACE, THETA_0
from applr_ros1.robots import JACKAL
from applr_ros1.senses.standing import ACTIVE, PREEMPTING
from applr_ros1.stack.simulated import SimulatedRobot
from sim_bridge.kinematic_simulator import KinematicSimulator
from tests.support import lines_with
from tests.support.bags import read, write
from tests.support.drives import Messages, decided, whole_drive
from training.appld import __main__ as appld
from training.appld import demonstrate
from training.appld.scripted_driver import Demonstrator
from training.bags.maker import Maker
from training.bags.read import BagError, bags_in
from training.bags.write import BagWriter
from training.env.env import ApplrEnv
from training.env.reward import Reward
from training.env.trajectory import Trajectory, TransitionLayout
from training.train import bags_to_dataset
from training.train.learner.config import RECIPES
from training.train.learner.config import parse as config_of
from training.train.learner.prepare import dataset_of
from training.train.replay.dataset import Dataset
from training.train.transitions import Skipped, check_motion, decision_period, transitions
from training.tune import __main__ as tune_robot


class Drive:
    """Synthetic drive along x at 50 Hz. It writes messages to a bag, and keeps the observations of
    a node.

    Args:
        without: Topics that are not written.
        stands_from: Step from which the robot stays in its place.
        scan: scan(ranges, k) returns the scan to write in step k, or None for no scan.
        after: after(drive, t, k) is called after each step.
        recorded: recorded(number, seen) returns the inputs to write in a decision.

    Attributes:
        observations: Observation (729,) of each decision, as the node had it.
        thetas: Parameter set of each decision.
        pose, latest: Pose (x, y, yaw) and ranges (720,) of the latest odometry and scan.
    """

    def __init__(
        self,
        writer,
        *,
        begin=10.0,
        seconds=9.0,
        status=SUCCEEDED,
        seed=0,
        without=(),
        goal="g",
        every=100,
        stands_from=1000,
        scan=lambda ranges, k: ranges,
        after=lambda drive, t, k: None,
        recorded=lambda number, seen: seen,
    ):
        self.writer = writer
        self.goal = goal
        self.without = without
        self.every = every
        self.stands_from = stands_from
        self.scan = scan
        self.recorded = recorded
        self.rng = np.random.default_rng(seed)
        self.observations = []
        self.thetas = []
        self.number = 0
        self.theta = THETA_0
        steps = int(round(seconds * 50))
        writer.goal(begin, (10.0, 0.1, 0.0))
        for k in range(steps + 1):
            t = begin + 0.02 * k
            self.step(t, k)
            after(self, t, k)
        self.end(t)
        if status is not None:
            writer.result(t, goal, status)
            writer.status(t, goal, running=False)

    def step(self, t, k):
        """Write the messages of step k at time t [s]."""
        # The status comes at 5 Hz, as from move_base.
        if k % 10 == 0 and "status" not in self.without:
            self.writer.status(t, self.goal)
        # 0.5 m/s along x, up to a step; the heading swings.
        self.pose = (0.01 * min(k, self.stands_from), 0.1, 0.2 * np.sin(0.01 * k))
        if "odometry" not in self.without:
            self.writer.odometry(t, self.pose, (0.5, 0.0))
        # Random ranges: an observation with a scan of another step would differ.
        self.ranges = self.rng.uniform(0.3, 3.0, 720).astype(np.float32)
        scan = self.scan(self.ranges, k)
        if scan is not None:
            self.latest = self.ranges
            if "scan" not in self.without:
                self.writer.scan(t, scan)
        if k % self.every == 0:
            self.decide(t)

    def end(self, t):
        """Do nothing: this node does not publish what it sees at the end."""

    def seen(self):
        """Return the inputs of a decision. The plan turns left by .01 rad at each decision."""
        laser = JACKAL.laser
        x, y, yaw = self.pose
        bearing = yaw + 0.01 * self.number
        distances = np.linspace(0.0, 5.0, 100)
        plan_x = x + distances * np.cos(bearing)
        plan_y = y + distances * np.sin(bearing)
        return Seen(
            scan=(self.latest, laser.first_angle, laser.increment),
            time=0.0,
            pose=self.pose,
            twist=(0.5, 0.0),
            goal=(10.0, 0.1, 0.0),
            plan=np.column_stack([plan_x, plan_y]),
            movers=np.zeros((0, 4)),
        )

    def decide(self, t):
        """Make a random decision, keep it, and write it."""
        seen = self.seen()
        theta_before = self.theta
        context = Context.of(theta_before, seen, SPACE, LAYOUT)
        self.observations.append(context.observation)
        self.number += 1
        self.theta = SPACE.to_theta(self.rng.uniform(-1, 1, len(SPACE)))
        if "decision" not in self.without:
            self.writer.decision(
                t,
                self.number,
                self.goal,
                self.recorded(self.number, seen),
                SPACE.as_dict(theta_before),
                SPACE.as_dict(self.theta),
            )
        self.thetas.append(self.theta)


def record(path, kind=Drive, **options):
    """Write a bag with one drive, and return the drive."""
    with Messages(path) as writer:
        return kind(writer, **options)


def rebuild(path, robot=JACKAL, **options):
    """Return the transitions of a bag, and {reason: number of courses that were skipped}."""
    return transitions(read(path, robot), robot, **options)


def assert_equal(trajectory, drive, count=None, ends=True):
    """Compare a trajectory with a drive. With `ends`, the course ends with the observation of the
    last decision.
    """
    if count is None:
        count = len(drive.thetas)
    assert len(trajectory) == count
    observations = [*drive.observations, drive.observations[-1]]
    expected = np.array(observations[: count + 1])
    encoding = PaperEncoding(JACKAL)
    actions = list(map(encoding.action, drive.thetas[:count]))
    if ends:
        # Scan and goal angle of the last decision, after its action
        scan_and_goal = expected[-2, :721]
        expected[-1] = np.concatenate([scan_and_goal, actions[-1]])
    stored_scans = TransitionLayout().quantise(expected)
    np.testing.assert_array_equal(trajectory.scan, stored_scans)
    np.testing.assert_allclose(trajectory.rest, expected[:, 720:], atol=1e-6)
    np.testing.assert_allclose(trajectory.action, actions, atol=1e-6)


def assert_alike(value, expected):
    """Compare values of rows. Headings pass through quaternions, and scans are single precision."""
    if isinstance(expected, dict):
        value = sorted(value.items())
        expected = sorted(expected.items())
    if isinstance(expected, (list, tuple, np.ndarray)):
        for entry, expected_entry in zip(value, expected, strict=True):
            assert_alike(entry, expected_entry)
    elif isinstance(expected, float):
        assert value == pytest.approx(expected, rel=1e-7, abs=1e-9, nan_ok=True)
    else:
        assert value == expected


def test_a_drive_that_is_written_and_read_back_is_the_same(bag_path):
    drive = whole_drive(JACKAL)
    read_back = read(write(bag_path, drive))

    rows = rows_of(drive, JACKAL)
    assert {row.key for row in rows} == set(COLUMNS) - {"routes"}
    assert_alike(rows_of(read_back, JACKAL), rows)
    for field_name in ("frame", "planners", "source", "goals"):
        assert getattr(read_back, field_name) == getattr(drive, field_name), field_name

    # The clock of the recorder, from the first message that is read on
    contacts_alone = read(bag_path, columns=("contacts",))
    assert contacts_alone.contacts[0] == 0.0
    later = contacts_alone.recorded_at - read_back.recorded_at
    assert later == pytest.approx(read_back.contacts[0], abs=1e-6)


def test_decisions_of_older_bags_do_not_tell_whether_costmaps_were_cleared():
    decision = decided({"max_vel_x": 0.5})._replace(cleared=True)
    column = COLUMNS["decisions"]
    fields = column.pack(decision._asdict(), Sender(JACKAL, "odom"))
    message = Maker().make(column.type, fields)
    assert [row["cleared"] for row in column.unpack(message)] == [True]
    older_fields = {name: value for name, value in vars(message).items() if name != "cleared"}
    older_message = SimpleNamespace(**older_fields)
    assert [row["cleared"] for row in column.unpack(older_message)] == [False]


def test_a_written_bag_has_plans_of_the_planner_that_drove_and_twists_along_x_alone(bag_path):
    drive = replace(whole_drive(JACKAL), planners=["DWAPlannerROS"])
    write(bag_path, drive)
    assert read(bag_path).planners == ["DWAPlannerROS"]
    twists = []
    with AnyReader([bag_path]) as reader:
        for connection, _, raw_message in reader.messages():
            if connection.msgtype == "geometry_msgs/msg/Twist":
                twists.append(reader.deserialize(raw_message, connection.msgtype))
    assert twists
    for twist in twists:
        unused = (twist.linear.y, twist.linear.z, twist.angular.x, twist.angular.y)
        assert unused == (0.0, 0.0, 0.0, 0.0)


def test_the_clearance_of_a_recorded_drive_is_the_smallest_range_of_each_scan(bag_path):
    read_back = read(write(bag_path, whole_drive(JACKAL)))
    assert read_back.clearances.nearest.tolist() == pytest.approx([1.0, 0.5, 0.7])


def test_the_drives_of_a_bag_follow_each_other_with_a_pause(bag_path):
    drive = whole_drive(JACKAL)
    read_back = read(write(bag_path, drive, drive))
    # The second drive begins 5 s after the end of the first, at 2.5 s.
    begin_times = [goal.begin for goal in read_back.goals]
    assert begin_times == pytest.approx([0.0, 2.0, 7.5, 9.5])
    np.testing.assert_allclose(read_back.odometry.time, [0.0, 1.0, 2.5, 7.5, 8.5, 10.0])


def test_a_bag_that_could_not_be_completed_is_removed(tmp_path):
    with suppress(KeyError), BagWriter(tmp_path / "a.bag") as writer:
        writer.write(whole_drive(JACKAL))
        raise KeyError
    assert not list(tmp_path.iterdir())


def test_transitions_equal_the_nodes_observations_and_decisions(bag_path):
    drive = record(bag_path)
    (trajectory,), skipped = rebuild(bag_path)
    assert_equal(trajectory, drive)
    assert trajectory.terminated
    assert skipped == {}
    # R_f = -1 until the goal, R_p is the distance driven towards it, R_c = -.05 / nearest range of
    # the last scan.
    ranges = trajectory.scan[1:-1] * TransitionLayout().step
    nearest_ranges = np.array([*ranges.min(axis=1), drive.latest.min()])
    r_f = np.array([-1, -1, -1, -1, 0])
    r_p = np.array([1, 1, 1, 1, 0.5])
    r_c = -0.05 / nearest_ranges
    # Stored ranges are exact to half a step only.
    np.testing.assert_allclose(trajectory.reward, r_f + r_p + r_c, atol=0.02)


def test_a_dataset_says_in_how_much_of_it_the_robot_stood(tmp_path, bag_path, capsys):
    record(bag_path, stands_from=200)  # a decision each 100 steps, four and a half of them
    assert bags_to_dataset.main([str(bag_path), "--out", str(tmp_path / "data")]) == 0
    bag_line, dataset_line = capsys.readouterr().out.splitlines()
    stood = "the robot stood in 60 % of the transitions"
    assert bag_line == f"{bag_path}: 5 transitions in 1 episodes, {stood}"
    assert dataset_line.startswith(f"{tmp_path}/data: {stood}; 5 transitions in ")


def test_a_decision_was_made_at_its_recorded_pose(bag_path):
    """At .5 m/s, the odometry of all decisions but the first is .1 s old."""

    def behind(number, seen):
        x, y, yaw = seen.pose
        offset = 0.05 if number > 1 else 0.0
        return seen._replace(pose=(x - offset, y, yaw))

    record(bag_path, recorded=behind)
    (trajectory,), _ = rebuild(bag_path, reward=Reward(c_f=0.0, c_c=0.0))
    assert trajectory.reward[:2].tolist() == pytest.approx([0.95, 1.0], abs=1e-3)


def test_the_period_is_the_median_interval_in_whole_cycles():
    stamps = (0.0, 1.7, 3.71, 5.7, 7.71, 7.9)
    decisions = [decided({}, time)._replace(goal="g") for time in stamps]
    assert decision_period(Recorded(decisions=decisions)) == 2.0
    assert decision_period(Recorded(decisions=decisions[:1])) is None


def test_bags_of_two_decision_periods_are_no_dataset(tmp_path, capsys, monkeypatch):
    record(tmp_path / "a.bag")
    record(tmp_path / "b.bag")
    periods = iter([2.0, None, 1.0, 2.0])
    monkeypatch.setattr(bags_to_dataset, "decision_period", lambda drive: next(periods))
    arguments = [str(tmp_path / "a.bag"), str(tmp_path / "b.bag"), "--out", str(tmp_path / "out")]
    # A bag that does not show its period has that of the others.
    assert bags_to_dataset.main(arguments) == 0
    assert Dataset(tmp_path / "out").about["decision_period"] == 2.0
    arguments[-1] = str(tmp_path / "mixed")
    assert bags_to_dataset.main(arguments) == 1
    assert "the bags differ in decision period [s], 1, 2: give" in capsys.readouterr().err
    assert not (tmp_path / "mixed" / "data").exists()


def test_a_bag_with_fewer_scans_than_the_node_got_has_the_nodes_observations(bag_path):
    def every_other(ranges, k):
        # The first decision, in step 0, needs a scan.
        return ranges if k % 2 or not k else None

    drive = record(bag_path, scan=every_other)
    (trajectory,), skipped = rebuild(bag_path)
    assert_equal(trajectory, drive)
    assert skipped == {}


def test_scans_in_the_lasers_own_time_give_no_transitions(bag_path):
    record(bag_path)
    drive = read(bag_path)
    drive.scans = replace(drive.scans, stamp=drive.scans.stamp + 60.0)
    with pytest.raises(ApplrError) as refusal:
        transitions(drive)
    assert str(refusal.value) == (
        "scans are stamped 60.0 s after the odometry: the clocks differ; "
        "set the driver of the laser to the computer's time"
    )


@pytest.mark.parametrize("seconds", [0.8, 5.0])
def test_the_period_is_that_of_the_recorded_decisions(bag_path, seconds):
    """Rewards scale with the period, as in training. A course of two decisions uses the period of
    the other course.
    """
    steps_per_decision = int(50 * seconds)
    with Messages(bag_path) as writer:
        four_decisions = Drive(
            writer,
            begin=10.0,
            seconds=3.5 * seconds,
            goal="g4",
            every=steps_per_decision,
        )
        two_decisions = Drive(
            writer,
            begin=60.0,
            seconds=1.5 * seconds,
            goal="g2",
            every=steps_per_decision,
        )
    time_cost_alone = Reward(c_p=0.0, c_c=0.0)

    rebuilt, skipped = rebuild(bag_path, reward=time_cost_alone)

    assert skipped == {}
    drives = (four_decisions, two_decisions)
    for drive, trajectory, count in zip(drives, rebuilt, (4, 2), strict=True):
        assert_equal(trajectory, drive, count)
        # A reward of -1 is that of the paper's 2 s. Arriving costs no time.
        rewards = [-seconds / 2] * (count - 1) + [0.0]
        np.testing.assert_allclose(trajectory.reward, rewards, atol=1e-6)


class PublishesEnd(Drive):
    """Drive whose node publishes its observation at the end of the course."""

    def end(self, t):
        seen = self.seen()
        context = Context.of(self.theta, seen, SPACE, LAYOUT)
        self.observations.append(context.observation)
        theta = SPACE.as_dict(self.theta)
        self.writer.decision(t + 0.2, self.number, self.goal, seen, theta)


INTERRUPTED = "a course was interrupted soon after a decision"


@pytest.mark.parametrize(
    ("kind", "status", "seconds", "finish", "count", "terminated", "skipped"),
    [
        (Drive, GAVE_UP, 9.0, None, 5, True, {}),
        (Drive, REJECTED, 9.0, None, 5, True, {}),
        (Drive, PREEMPTED, 9.0, None, 4, False, {}),
        (Drive, PREEMPTED, 9.98, None, 4, False, {}),
        (Drive, None, 9.0, None, 4, False, {}),
        # The finish line is reached before the goal, at 0.5 m/s after 7 s.
        (Drive, PREEMPTED, 9.0, 3.5, 4, True, {}),
        (PublishesEnd, SUCCEEDED, 9.0, None, 5, True, {}),
        (PublishesEnd, SUCCEEDED, 8.4, None, 5, True, {}),
        (PublishesEnd, PREEMPTED, 9.8, None, 5, False, {}),
        (PublishesEnd, PREEMPTED, 8.4, None, 4, False, {INTERRUPTED: 1}),
        (PublishesEnd, None, 9.8, None, 5, False, {}),  # The node was switched off.
    ],
)
def test_each_end_of_a_course_gives_its_transitions(
    bag_path, kind, status, seconds, finish, count, terminated, skipped
):
    """If the node does not publish its observation at the end, the observation of the last decision
    is used.
    """
    # Decisions come every 2 s: the fifth at 8 s, of which a course of 9 s has the half.
    drive = record(bag_path, kind, status=status, seconds=seconds)
    (trajectory,), reasons = rebuild(bag_path, finish=finish)
    assert trajectory.terminated == terminated
    assert reasons == skipped
    assert_equal(trajectory, drive, count, ends=terminated and kind is Drive)
    # No time cost at the goal.
    assert (trajectory.reward[-1] > 0.0) == (status == SUCCEEDED or finish is not None)


def test_a_course_ends_with_its_result_or_with_its_status_whichever_is_earlier(tmp_path):
    # The course begins with its status at 1 s, and the status ends it at 11 s.
    for result_stamp, end in ((8.0, 7.0), (12.0, 10.0)):
        bag_path = tmp_path / f"{result_stamp}.bag"
        with Messages(bag_path) as writer:
            writer.status(1.0, "g")
            writer.status(11.0, "g", running=False)
            writer.result(result_stamp, "g", SUCCEEDED)
        (goal,) = read(bag_path).goals
        assert goal.status == "reached"
        assert goal.end == end


def test_a_goal_that_is_being_cancelled_is_still_pursued(bag_path):
    with Messages(bag_path) as writer:
        writer.status(10.0, "g", running=False, ended=ACTIVE)
        writer.status(11.0, "g", running=False, ended=PREEMPTING)
        writer.status(12.0, "g", running=False, ended=PREEMPTED)
    (goal,) = read(bag_path).goals
    assert goal.begin == 0.0
    assert goal.end == 2.0


def test_a_course_does_not_remember_the_one_before_it_that_never_ended(tmp_path):
    with Messages(tmp_path / "two.bag") as writer:
        Drive(writer, begin=10.0, status=None, goal="left")
        Drive(writer, begin=20.0, seed=1, goal="g")
    record(tmp_path / "one.bag", begin=20.0, seed=1, goal="g")
    # This encoding remembers the previous observation of a course.
    (_, after_another), _ = rebuild(tmp_path / "two.bag", observation=DIMENSIONLESS)
    (alone,), _ = rebuild(tmp_path / "one.bag", observation=DIMENSIONLESS)
    np.testing.assert_array_equal(after_another.scan, alone.scan)
    np.testing.assert_array_equal(after_another.rest, alone.rest)


def test_a_node_that_is_switched_off_and_on_leaves_a_gap(bag_path):
    """The node stops after 3.8 s and decides again from 6 s on."""

    class Switched(Drive):
        def decide(self, t):
            if t != pytest.approx(14.0):
                super().decide(t)
                return
            # Instead of the third decision, the node published the end of a course.
            theta = SPACE.as_dict(self.theta)
            self.writer.decision(t - 0.2, self.number, self.goal, self.seen(), theta)

    record(bag_path, Switched)
    (before_gap, after_gap), skipped = rebuild(bag_path)
    assert len(before_gap) == 2
    assert len(after_gap) == 2
    assert not before_gap.terminated
    assert after_gap.terminated
    assert skipped == {}


@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_a_bag_converted_by_rosbags_convert_gives_the_same_transitions(tmp_path, storage):
    # Given: a bag, converted to ROS 2 and back
    original = tmp_path / "a.bag"
    ros2_bag = tmp_path / "ros2"
    ros1_bag = tmp_path / "back.bag"
    drive = record(original)
    command = Path(sys.executable).with_name("rosbags-convert")
    for source, destination in ((original, ros2_bag), (ros2_bag, ros1_bag)):
        paths = ["--src", source, "--dst", destination]
        subprocess.run([command, *paths, "--dst-storage", storage], check=True)
    # One bag, although the folder has several files.
    assert bags_in([ros2_bag]) == [ros2_bag]
    assert bags_in([tmp_path]) == [original, ros1_bag, ros2_bag]
    # ROS 2's file of messages alone, without metadata.yaml, as people send it by mail
    (messages_alone,) = [file for file in ros2_bag.iterdir() if file.name != "metadata.yaml"]
    sent_by_mail = Path(shutil.copy(messages_alone, tmp_path))
    assert sent_by_mail in bags_in([tmp_path])

    # Then: all of them have the transitions of the drive
    (expected,), _ = rebuild(original)
    assert_equal(expected, drive)
    for number, bag_path in enumerate([ros2_bag, ros1_bag, sent_by_mail]):
        dataset_folder = tmp_path / f"out{number}"
        assert bags_to_dataset.main([str(bag_path), "--out", str(dataset_folder)]) == 0
        (stored,) = Dataset(dataset_folder).trajectories()
        for field_name in ("scan", "rest", "action", "reward"):
            stored_bytes = getattr(stored, field_name).tobytes()
            assert stored_bytes == getattr(expected, field_name).tobytes()


def test_of_a_folder_only_its_bags_are_read(tmp_path):
    for file_name in ("b.bag", "a.bag", "notes.txt"):
        (tmp_path / file_name).touch()
    assert bags_in([tmp_path]) == [tmp_path / "a.bag", tmp_path / "b.bag"]


def test_a_bag_that_rosbag_has_not_finished_says_how_to_mend_it(tmp_path):
    whole_bag = tmp_path / "whole.bag"
    record(whole_bag)
    active_bag = tmp_path / "drive.bag.active"
    active_bag.write_bytes(whole_bag.read_bytes()[:5000])
    remedy = "cut short, rename it to .bag, run rosbag reindex$"
    with pytest.raises(BagError, match=remedy):
        read(active_bag)
    # Whoever recorded it asks about the name that he gave.
    with pytest.raises(BagError, match=f"; there is drive.bag.active: .*{remedy}"):
        read(tmp_path / "drive.bag")


def test_code_in_a_message_definition_is_not_run(tmp_path):
    """ROS's own rosbag generates Python code from the name of such a constant."""
    code = f"uint8 {{0:open('{tmp_path}/ran','w')}}[0]=5\nbool data\n"
    definitions = (
        code,
        code.replace("[0]=5", "=5"),
        f"string A={code[6:]}",
    )
    for number, definition in enumerate(definitions):
        bag_path = tmp_path / f"{number}.bag"
        with Writer(bag_path) as writer:
            connection = writer.add_connection(
                "/front/scan",
                "std_msgs/msg/Bool",
                msgdef=definition,
                md5sum="1" * 32,
            )
            writer.write(connection, SECOND, b"\1")
        with pytest.raises(BagError, match=f"{number}.bag: "):
            read(bag_path)
    assert not (tmp_path / "ran").exists()


@pytest.mark.fault("18d")
def test_a_stopped_demonstration_leaves_no_bag(tmp_path, monkeypatch):
    monkeypatch.setattr(Demonstrator, "command", Mock(side_effect=KeyboardInterrupt))
    arguments = [str(tmp_path / "part.bag"), "--world", "generated:0", "--simulator", "kinematic"]
    assert demonstrate.main(arguments) == 130
    assert not list(tmp_path.iterdir())


# First bytes of a chunk by compression
MAGIC = {"BZ2": b"BZh", "LZ4": b"\x04\x22\x4d\x18"}


def copy_messages(whole_bag, writer, first_bytes=lambda topic, number: None):
    """Copy a bag. Of a topic's message of a number, first_bytes may leave some of the bytes."""
    numbers = Counter()
    with writer, AnyReader([whole_bag]) as reader:
        written_connections = {}
        for connection in reader.connections:
            definition = connection.msgdef.data
            written_connections[connection.id] = writer.add_connection(
                connection.topic, connection.msgtype, msgdef=definition, md5sum=connection.digest
            )
        for connection, recording_time, raw_message in reader.messages():
            kept_bytes = first_bytes(connection.topic, numbers[connection.topic])
            numbers[connection.topic] += 1
            written = raw_message[:kept_bytes]
            writer.write(written_connections[connection.id], recording_time, written)


def test_messages_that_are_cut_are_left_out_and_counted(tmp_path, caplog):
    # Given: a bag of which a scan, two messages of odometry and a plan are cut
    drive = whole_drive(JACKAL)
    whole_bag = write(tmp_path / "whole.bag", drive)
    cut_messages = {
        ("/front/scan", 1): 60,
        ("/odometry/filtered", 0): 0,
        ("/odometry/filtered", 2): 100,
        ("/move_base/TrajectoryPlannerROS/global_plan", 0): 40,
    }
    copy_messages(
        whole_bag,
        Writer(tmp_path / "cut.bag"),
        lambda topic, number: cut_messages.get((topic, number)),
    )

    # Then: all others are read, and a line counts those by topic
    read_back = read(tmp_path / "cut.bag")
    assert read_back.scans.stamp.tolist() == drive.scans.stamp[[0, 2]].tolist()
    assert read_back.odometry.stamp.tolist() == drive.odometry.stamp[[1]].tolist()
    assert len(read_back.plans) == len(drive.plans) - 1
    assert len(read_back.planned) == len(drive.planned)
    (line,) = [record.message for record in caplog.records if record.levelname == "WARNING"]
    assert line == (
        "cut.bag: messages cut or damaged, left out: 2 on /odometry/filtered, "
        "1 on /move_base/TrajectoryPlannerROS/global_plan, 1 on /front/scan"
    )


def write_damaged_chunk(bag_path, whole_bag, compression):
    """Write the messages of a bag in a compressed chunk with wrong bytes."""
    writer = Writer(bag_path)
    writer.set_compression(compression)
    copy_messages(whole_bag, writer)
    content = bytearray(bag_path.read_bytes())
    chunk_begin = content.index(MAGIC[compression.name])
    content[chunk_begin : chunk_begin + 100] = bytes(100)
    bag_path.write_bytes(content)


@pytest.mark.heavy
@pytest.mark.fault("18")
def test_fault_18_bags_that_lack_something_are_skipped_and_counted(tmp_path, capsys):
    # Given: a folder with a whole bag and ten damaged ones
    whole_bag = tmp_path / "whole.bag"
    record(whole_bag)
    (tmp_path / "cut_short.bag").write_bytes(whole_bag.read_bytes()[:5000])
    (tmp_path / "text.bag").write_text("no bag at all\n" * 100)
    with Messages(tmp_path / "nothing.bag"):
        pass
    reasons = {
        "cut_short.bag": "damaged or of another kind: if its recording was cut short",
        "text.bag": "damaged or of another kind",
        "nothing.bag": "the bag holds no messages",
    }
    os.mkfifo(tmp_path / "pipe.bag")
    reasons["pipe.bag"] = "a pipe or device"
    for compression in Writer.CompressionFormat:
        bag_name = f"{compression.name}.bag"
        write_damaged_chunk(tmp_path / bag_name, whole_bag, compression)
        reasons[bag_name] = "cannot be read"
    for missing, reason in (
        ("scan", "no scans"),
        ("odometry", "no odometry"),
        ("status", "no goals on /move_base/status"),
        ("decision", "no decisions"),
    ):
        record(tmp_path / f"no_{missing}.bag", without=(missing,))
        reasons[f"no_{missing}.bag"] = reason

    # When: the folder is converted
    arguments = [str(tmp_path), "--out", str(tmp_path / "out")]
    assert bags_to_dataset.main(arguments) == 0

    # Then: the whole bag is in the dataset, and each other one with its reason
    dataset = Dataset(tmp_path / "out")
    source = dataset.about
    assert source["robot"] == "jackal"
    assert source["decision_period"] == 2.0
    assert dataset.transitions == 5
    driven = "5 transitions in 0.0028 h of driving"
    printed = capsys.readouterr().out
    assert f"the robot stood in 0 % of the transitions; {driven}\n" in printed
    assert set(source["bags"]) == {"whole.bag", *reasons}
    for bag_name, reason in reasons.items():
        (line,) = lines_with(printed, f"{tmp_path}/{bag_name}: 0 transitions in 0 episodes, ")
        assert reason in line
    assert sum(source["skipped"].values()) >= len(reasons)

    # A dataset is not overwritten.
    assert bags_to_dataset.main(arguments) == 1
    assert "already" in capsys.readouterr().err


def test_only_the_courses_around_a_clock_jump_are_lost(bag_path):
    with Messages(bag_path) as writer:
        undamaged = Drive(writer, begin=10.0, goal="before", seed=1)
        Drive(writer, begin=40.0, goal="torn", seed=2, seconds=9.0)
        # The clock jumped back to 43 s.
        Drive(writer, begin=43.0, goal="again", seed=3, seconds=9.0)
    (trajectory,), skipped = rebuild(bag_path)
    assert_equal(trajectory, undamaged)
    assert "the odometry jumped" in skipped


# The third decision is in force from step 200 to 300.


def gap(ranges, k):
    """Return no scan for more than a second."""
    return None if 230 < k < 290 else ranges


def person(drive, t, k):
    """Change a parameter, as a person with rqt_reconfigure."""
    if k == 275:
        drive.theta = SPACE.from_dict({"max_vel_x": 1.23})


def jump(drive, t, k):
    """Write odometry that is metres away."""
    if k == 250:
        drive.writer.odometry(t + 0.001, (5.0, 5.0, 0.0), (0.0, 0.0))


class Misses(Drive):
    """Drive whose node misses the third decision."""

    def decide(self, t):
        if t != 14.0:
            super().decide(t)


@pytest.mark.parametrize(
    ("changes", "lengths", "reason"),
    [
        ({"scan": gap}, [2, 2], "scans are missing"),
        ({"after": jump}, [], "the odometry jumped"),
        ({"after": person}, [2, 2], "parameters were changed"),
        ({"kind": Misses}, [1, 2], "a decision's period differs from the others"),
    ],
    ids=["gap", "moved", "person", "missed"],
)
def test_gaps_jumps_and_changes_cut_an_episode(bag_path, changes, lengths, reason):
    record(bag_path, **changes)
    rebuilt, skipped = rebuild(bag_path)
    assert list(map(len, rebuilt)) == lengths, skipped
    assert any(reason in text for text in skipped), skipped
    # Only the end of the course is an end of an episode; a cut is not.
    is_terminated = [trajectory.terminated for trajectory in rebuilt]
    assert is_terminated == [False, True][: len(rebuilt)]


@pytest.mark.parametrize(
    ("seconds", "moved", "jumps"),
    [
        (0.1, 0.79, False),
        (0.1, 0.81, True),
        (2.0, 10.2, False),
        (2.0, 10.4, True),
    ],
)
def test_odometry_jumps_if_it_moves_more_than_thirty_centimetres_beyond_five_metres_a_second(
    seconds, moved, jumps
):
    stamps = np.array([0.0, seconds])
    poses = np.array([[1.0, 2.0, 0.0], [1.0, 2.0 - moved, 0.0]])
    odometry = Motion(stamps, stamps, poses, np.zeros((2, 2)))
    expectation = nullcontext()
    if jumps:
        expectation = pytest.raises(Skipped, match="the odometry jumped")
    with expectation:
        check_motion(odometry, Goal("g", 0.0, seconds))


def test_a_contact_is_charged_in_its_decision(bag_path):
    def touch(drive, t, k):
        if k in (250, 260):
            drive.writer.contact(t)

    record(bag_path, after=touch)
    (plain,), _ = rebuild(bag_path)
    (charged,), _ = rebuild(bag_path, reward=Reward(c_collision=3.0))
    # Two contacts in the third decision cost as much as one.
    np.testing.assert_allclose(charged.reward - plain.reward, [0, 0, -3, 0, 0], atol=1e-6)


def test_rewards_have_the_scale_and_pace_of_the_encoding(bag_path):
    """For a base of half the Jackal's speed, time costs half as much."""
    record(bag_path)
    slow_base = JACKAL.base.model_copy(update={"max_speed": 1.0})
    slow_robot = replace(JACKAL, base=slow_base)
    for robot, cost in ((JACKAL, -1.0), (slow_robot, -0.5)):
        (trajectory,), _ = rebuild(
            bag_path,
            robot,
            observation="dimensionless",
            reward=Reward(c_p=0.0, c_c=0.0),
        )
        assert trajectory.reward.tolist() == pytest.approx([cost] * 4 + [0.0])


def test_a_recipe_sets_encoding_and_reward_and_training_refuses_others(tmp_path, bag_path):
    # Given: a dataset of a recipe that differs from the Jackal's in one value
    record(bag_path)
    dataset_folder = str(tmp_path / "data")
    recipe_file = tmp_path / "own.yaml"
    recipe = RECIPES["jackal"].read_text()
    recipe_file.write_text(recipe.replace("lowest: true", "lowest: false"))
    options = ["--out", dataset_folder, "--recipe", str(recipe_file)]
    assert bags_to_dataset.main([str(bag_path), *options]) == 0
    source = Dataset(dataset_folder).about
    assert source["observation"] == "dimensionless"
    assert source["robot"] == "jackal"
    assert source["decision_period"] == 2.0
    assert source["failure_seconds"] == 11.0
    assert source["exact_time"] is True
    assert source["lowest"] is False

    # Then: training with the Jackal's recipe refuses it. Bags have nothing for critics that know
    # more, which that recipe wants, too.
    run_options = ["--dataset", dataset_folder, "--recipe", "jackal", "--decision-period", "2"]
    run_options += ["--out", str(tmp_path / "run")]
    line = "critics_know_more is True, but the .*data was driven with False: give the same"
    config = config_of(run_options)
    with pytest.raises(ApplrError, match=line):
        dataset_of(config)


def zeros(ranges, k):
    """Return 0 for beams without a return, as some lasers do, and only zeros between the third and
    fourth decision.
    """
    if 210 < k < 390 and k % 100:
        return np.zeros(720)
    return np.where(np.arange(720) % 7, 1.6, 0.0)


@pytest.mark.parametrize(
    ("scan", "lowest", "nearest"),
    [
        (zeros, False, 1.6),
        (zeros, True, 1.6),
        (lambda ranges, k: np.full(720, -np.inf), False, 0.4),
    ],
)
def test_the_clearance_term_uses_the_smallest_range(bag_path, scan, lowest, nearest):
    """A range of -inf is too near to measure and counts as the laser's minimum range."""
    record(bag_path, scan=scan)
    laser = JACKAL.laser.model_copy(update={"range_min": 0.4})
    clearance_alone = Reward(c_f=0.0, c_p=0.0, lowest=lowest)
    (trajectory,), skipped = rebuild(
        bag_path,
        replace(JACKAL, laser=laser),
        reward=clearance_alone,
    )
    assert skipped == {}
    np.testing.assert_allclose(trajectory.reward, -0.05 / nearest, rtol=1e-5)


class ExactOdometry(KinematicSimulator):
    """Simulator without odometry drift."""

    def advance(self, seconds):
        state = super().advance(seconds)
        self.set_odometry(self.to_odom(state.pose))
        return self.state


class RecordedEnv(ApplrEnv):
    """Environment whose drives have all columns."""

    def begin(self, world, seed, rules):
        return super().begin(world, seed, rules, record=True)


def driven(path, observation, world, time_limit, **settings):
    """Drive two courses in a world, record them in a bag, and return the environment's transitions.

    The environment rewards true progress to the course's goal; from a bag, only odometry and the
    sent goal are known. So the odometry is exact here, and the course has its goal where the goal
    is sent.
    """
    settings.update(observation=observation, period=1.0, movers=True)
    loaded_world = worlds.load(world)
    course = replace(loaded_world.course, goal=loaded_world.course.sent_goal)
    settings["time_limit"] = time_limit
    env = RecordedEnv([replace(loaded_world, course=course)], **settings)
    env.simulated = SimulatedRobot(ExactOdometry(scan_noise=0.0), env.simulated.stack)
    layout = TransitionLayout.of(env.encoding)
    assert layout == env.layout
    rng = np.random.default_rng(3)
    trajectories = []
    drives = []
    mover_count = 0
    default_action = env.encoding.action(env.space.theta0)
    for seed in range(2):
        observation, _ = env.reset(seed=seed)
        observations = [observation]
        actions = []
        rewards = []
        terminated = truncated = False
        while not (terminated or truncated):
            # Mostly faster than the defaults, so that the drives end soon
            action = default_action + rng.uniform(-0.4, 0.8, env.encoding.actions)
            observation, reward, terminated, truncated, _ = env.step(action)
            observations.append(observation)
            rewards.append(reward)
            # What is in force: parameters are rounded, and clipped to their bounds.
            actions.append(env.encoding.action(env.course_drive.theta))
            mover_count += len(env.course_drive.seen.movers)
        trajectories.append(Trajectory.of(layout, observations, actions, rewards, terminated))
        drives.append(env.course_drive.drive)
    assert mover_count or "dynamic" not in world, "no moving obstacle was seen"
    write(path, *drives)
    return trajectories


def assert_same(rebuilt, expected):
    """Compare transitions field by field. A beam between two steps of the scan's resolution may
    differ by one step.
    """
    assert rebuilt.terminated == expected.terminated
    difference = rebuilt.scan.astype(int) - expected.scan
    assert np.abs(difference).max() <= 1
    assert (difference != 0).mean() < 1e-4
    for field_name, tolerance in (("rest", 1e-6), ("action", 1e-6), ("reward", 1e-5)):
        np.testing.assert_allclose(
            getattr(rebuilt, field_name),
            getattr(expected, field_name),
            rtol=0.0,
            atol=tolerance,
            err_msg=field_name,
        )


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("observation", "world", "limit"),
    [
        ("paper", "generated:2", 100.0),
        pytest.param("dimensionless", "dynamic:406", 9.0, marks=pytest.mark.slow),
    ],
)
def test_a_recorded_drive_equals_the_environments_transitions(
    tmp_path, bag_path, observation, world, limit
):
    """Covers the command, both encodings, moving obstacles, and ends at goal and time limit."""
    # Given: a drive in the environment, and its bag
    expected = driven(
        bag_path,
        observation,
        world,
        limit,
        reward={"lowest": True, "exact_time": True},
    )

    # When: the bag is converted with the environment's encoding and reward
    recipe_file = tmp_path / "own.yaml"
    recipe_file.write_text(f"observation: {observation}\nlowest: true\nexact_time: true\n")
    options = ["--recipe", str(recipe_file), "--out", str(tmp_path / "data")]
    assert bags_to_dataset.main([str(bag_path), *options]) == 0

    # Then: the dataset has the transitions of the environment
    dataset = Dataset(tmp_path / "data")
    assert dataset.about["observation"] == observation
    assert dataset.about["skipped"] == {}
    for rebuilt, trajectory in zip(dataset.trajectories(), expected, strict=True):
        assert_same(rebuilt, trajectory)


@pytest.mark.fault("23a")
@pytest.mark.parametrize(
    ("command", "arguments", "named"),
    [
        (appld, ["nowhere.bag", "--out", "x.safetensors"], "nowhere.bag"),
        (bags_to_dataset, ["x.bag"], "--out"),
        (bags_to_dataset, ["nowhere.bag", "--out", "out"], "nowhere.bag"),
        (bags_to_dataset, ["x.bag", "--out", "out", "--recipe", "none"], "none"),
        (tune_robot, ["jackal", "--minutes", "0"], "--minutes"),
    ],
)
def test_mistakes_on_the_other_command_lines_are_one_line(
    command, arguments, named, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    assert command.main(arguments) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert named in error
    assert not list(tmp_path.iterdir())
