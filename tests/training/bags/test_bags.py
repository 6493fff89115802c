"""Tests of the conversion of ROS 1 and ROS 2 bags to transitions: inputs and decisions of the node,
damaged data.
"""

import shutil
import subprocess
import sys
from contextlib import nullcontext, suppress
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.rosbag1 import Writer

import worlds
from applr_ros1 import robots
from applr_ros1.common.errors import ApplrError
from applr_ros1.drives.drive import (
    Changes,
    Commands,
    Decision,
    Goal,
    Motion,
    Plans,
    Scans,
    SentGoal,
)
from applr_ros1.drives.drive import Drive as Recorded
from applr_ros1.policy.decision import Context, Seen
from applr_ros1.policy.dimensionless import DIMENSIONLESS
from applr_ros1.policy.encoding import PaperEncoding
from applr_ros1.policy.observation import LAYOUT
from applr_ros1.policy.parameter_space import SPACE, THETA_0
from sim_bridge.kinematic_simulator import KinematicSimulator
from tests.support.drives import Messages, decided
from training.appld import __main__ as appld
from training.appld import demonstrate
from training.appld.scripted_driver import Demonstrator
from training.bags import SECOND
from training.bags.read import bags_in, read
from training.bags.topics import ACTIVE, GAVE_UP, PREEMPTED, PREEMPTING, REJECTED, SUCCEEDED
from training.bags.write import BagWriter, write
from training.env.env import ApplrEnv
from training.env.episode import Episode
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
        scan: scan(ranges, k) returns the scan to write in step k, or None for no scan.
        after: after(drive, t, k) is called after each step.
        recorded: recorded(number, seen) returns the inputs to write in a decision.
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
        scan=lambda ranges, k: ranges,
        after=lambda drive, t, k: None,
        recorded=lambda number, seen: seen,
    ):
        self.writer = writer
        self.goal = goal
        self.without = without
        self.every = every
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
            self.step(begin + 0.02 * k, k)
            after(self, begin + 0.02 * k, k)
        end = begin + 0.02 * steps
        self.end(end)
        if status is not None:
            writer.result(end, goal, status)
            writer.status(end, goal, running=False)

    def step(self, t, k):
        w = self.writer
        if k % 10 == 0 and "status" not in self.without:
            w.status(t, self.goal)
        self.pose = (0.01 * k, 0.1, 0.2 * np.sin(0.01 * k))
        if "odometry" not in self.without:
            w.odometry(t, self.pose, (0.5, 0.0))
        self.ranges = self.rng.uniform(0.3, 3.0, 720).astype(np.float32)
        scan = self.scan(self.ranges, k)
        if scan is not None:
            self.latest = self.ranges
            if "scan" not in self.without:
                w.scan(t, scan)
        if k % self.every == 0:
            self.decide(t)

    def end(self, t):
        pass

    def seen(self):
        """Return the inputs of a decision. The plan turns left by .01 rad at each decision."""
        laser = robots.JACKAL.laser
        bearing = self.pose[2] + 0.01 * self.number
        way = (
            np.linspace(0.0, 5.0, 100)[:, None] * [np.cos(bearing), np.sin(bearing)] + self.pose[:2]
        )
        scan = self.latest, laser.first_angle, laser.increment
        return Seen(scan, 0.0, self.pose, (0.5, 0.0), (10.0, 0.1, 0.0), way, np.zeros((0, 4)))

    def decide(self, t):
        seen = self.seen()
        before = self.theta
        self.observations.append(Context.of(before, seen, SPACE, LAYOUT).observation)
        self.number += 1
        self.theta = SPACE.to_theta(self.rng.uniform(-1, 1, len(SPACE)))
        if "decision" not in self.without:
            sets = map(SPACE.as_dict, (before, self.theta))
            self.writer.decision(t, self.number, self.goal, self.recorded(self.number, seen), *sets)
        self.thetas.append(self.theta)


def record(path, kind=Drive, **options):
    with Messages(path) as writer:
        return kind(writer, **options)


def rebuild(path, robot=robots.JACKAL, **options):
    return transitions(read(path, robot), robot, **options)


def assert_equal(trajectory, drive, count=None, ends=True):
    """Compare a trajectory with a drive. With `ends`, the course ends with the observation of the
    last decision.
    """
    count = len(drive.thetas) if count is None else count
    assert len(trajectory) == count
    expected = np.array([*drive.observations, drive.observations[-1]][: count + 1])
    actions = [PaperEncoding(robots.JACKAL).action(theta) for theta in drive.thetas[:count]]
    if ends:
        expected[-1] = np.concatenate([expected[-2, :721], actions[-1]])
    np.testing.assert_array_equal(trajectory.scan, TransitionLayout().quantise(expected))
    np.testing.assert_allclose(trajectory.rest, expected[:, 720:], atol=1e-6)
    np.testing.assert_allclose(trajectory.action, actions, atol=1e-6)


def whole_drive(robot):
    """Return a drive of three seconds with all columns that a bag has."""
    time = np.array([0.0, 1.0, 2.5])
    pose = np.array([[0.0, 0.0, 0.1], [1.0, -0.5, 0.4], [2.0, 0.5, -3.0]])
    twist = np.array([[0.0, 0.5], [1.0, -0.5], [0.25, 0.0]])
    fan = np.tile([-0.5, 0.5, 0.1, 30.0], (3, 1))
    ranges = np.array([[1.0, 2.0, 3.0], [0.5, 2.0, np.inf], [3.0, 0.7, 2.0]], np.float32)
    scan = ranges[1], -0.5, 0.5
    movers = np.array([[1.0, 2.0, -0.5, 0.25], [3.0, 4.0, 0.0, 1.0]])
    seen = Seen(scan, 1.0, (1.0, -0.5, 0.4), (1.0, -0.5), (5.0, 1.0, 0.2), pose[:, :2], movers)
    values = {"DWAPlannerROS/max_vel_x": 0.5, "inflation_radius": 0.25}
    changed = {"max_vel_x": 0.75, "prune_plan": True, "base_frame_id": "base_link"}
    return Recorded(
        frame="map",
        planners=[robot.local_planner],
        odometry=Motion(time, time, pose, twist),
        scans=Scans(time, time, fan, list(ranges)),
        plans=Plans(time[:2], [pose, np.zeros((0, 3))]),
        planned=Commands(time, twist),
        commands=Commands(time[1:], 0.5 * twist[1:]),
        changes=Changes(time[:2], ["DWAPlannerROS", "local_costmap"], [changed, {"width": 6.0}]),
        decisions=[Decision("first", 1.0, 1.0, values, {**values, "inflation_radius": 0.5}, seen)],
        ends=[Decision("first", 1.5, 1.5, values, {}, seen)],
        sent=[SentGoal(0.0, (5.0, 1.0, 0.2), "odom"), SentGoal(2.0, (1.0, 1.0, 0.0), "map")],
        goals=[Goal("first", 0.0, 1.5, "reached"), Goal("second", 2.0, 2.5, "aborted")],
        contacts=np.array([0.5, 2.25]),
        recoveries=np.array([0.75]),
        source={"driver": "a person", "course": 3},
    )


def assert_same_columns(read_back, written, columns):
    """Compare columns of two drives. Headings pass through quaternions, and become rounded."""
    for name in columns:
        ours, expected = vars(getattr(read_back, name)), vars(getattr(written, name))
        assert list(ours) == list(expected)
        for part in ours:
            for mine, theirs in zip(ours[part], expected[part], strict=True):
                np.testing.assert_allclose(mine, theirs, atol=1e-9, err_msg=f"{name}.{part}")


def test_a_drive_that_is_written_and_read_back_is_the_same(tmp_path):
    drive = whole_drive(robots.JACKAL)
    read_back = read(write(tmp_path / "a.bag", drive))
    columns = ("odometry", "scans", "plans", "planned", "commands")
    assert_same_columns(read_back, drive, columns)
    for name in ("frame", "planners", "source", "goals"):
        assert getattr(read_back, name) == getattr(drive, name), name
    assert read_back.changes.server == drive.changes.server
    assert read_back.changes.values == drive.changes.values
    assert read_back.changes.time.tolist() == drive.changes.time.tolist()
    np.testing.assert_allclose(read_back.contacts, drive.contacts)
    np.testing.assert_allclose(read_back.recoveries, drive.recoveries)
    for sent, expected in zip(read_back.sent, drive.sent, strict=True):
        assert sent.frame == expected.frame
        np.testing.assert_allclose([sent.time, *sent.pose], [expected.time, *expected.pose])
    made = zip(
        [*read_back.decisions, *read_back.ends], [*drive.decisions, *drive.ends], strict=True
    )
    for decision, expected in made:
        assert decision[:-1] == expected[:-1]
        for mine, theirs in zip(decision.seen, expected.seen, strict=True):
            np.testing.assert_equal(mine, theirs)


def test_a_written_bag_has_plans_of_the_planner_that_drove_and_twists_along_x_alone(tmp_path):
    drive = replace(whole_drive(robots.JACKAL), planners=["DWAPlannerROS"])
    path = write(tmp_path / "a.bag", drive)
    assert read(path).planners == ["DWAPlannerROS"]
    with AnyReader([path]) as reader:
        twists = [
            reader.deserialize(raw, connection.msgtype)
            for connection, _, raw in reader.messages()
            if connection.msgtype == "geometry_msgs/msg/Twist"
        ]
    assert twists
    for twist in twists:
        unused = (twist.linear.y, twist.linear.z, twist.angular.x, twist.angular.y)
        assert unused == (0.0, 0.0, 0.0, 0.0)


def test_the_clearance_of_a_recorded_drive_is_the_smallest_range_of_each_scan(tmp_path):
    read_back = read(write(tmp_path / "a.bag", whole_drive(robots.JACKAL)))
    assert read_back.clearances.nearest.tolist() == pytest.approx([1.0, 0.5, 0.7])


def test_the_drives_of_a_bag_follow_each_other_with_a_pause(tmp_path):
    drive = whole_drive(robots.JACKAL)
    read_back = read(write(tmp_path / "a.bag", drive, drive))
    begins = [goal.begin for goal in read_back.goals]
    assert begins == pytest.approx([0.0, 2.0, 7.5, 9.5])
    np.testing.assert_allclose(read_back.odometry.time, [0.0, 1.0, 2.5, 7.5, 8.5, 10.0])


def test_a_bag_that_could_not_be_completed_is_removed(tmp_path):
    with suppress(KeyError), BagWriter(tmp_path / "a.bag") as writer:
        writer.write(whole_drive(robots.JACKAL))
        raise KeyError
    assert not list(tmp_path.iterdir())


def test_transitions_equal_the_nodes_observations_and_decisions(tmp_path):
    drive = record(tmp_path / "a.bag")
    (trajectory,), skipped = rebuild(tmp_path / "a.bag")
    assert_equal(trajectory, drive)
    assert trajectory.terminated
    assert skipped == {}
    # R_f = -1 until the goal, R_p is the distance driven towards it, R_c = -.05 / nearest range of
    # the last scan.
    nearest = [*(trajectory.scan[1:-1].min(axis=1) * TransitionLayout().step), drive.latest.min()]
    expected = (
        np.array([-1, -1, -1, -1, 0]) + np.array([1, 1, 1, 1, 0.5]) - 0.05 / np.array(nearest)
    )
    np.testing.assert_allclose(trajectory.reward, expected, atol=0.02)


def test_a_decision_was_made_at_its_recorded_pose(tmp_path):
    """At .5 m/s, the odometry of all decisions but the first is .1 s old."""

    def behind(number, seen):
        x, y, yaw = seen.pose
        return seen._replace(pose=(x - 0.05 * (number > 1), y, yaw))

    record(tmp_path / "a.bag", recorded=behind)
    (trajectory,), _ = rebuild(tmp_path / "a.bag", reward=Reward(c_f=0.0, c_c=0.0))
    assert trajectory.reward[:2].tolist() == pytest.approx([0.95, 1.0], abs=1e-3)


def test_the_period_is_the_median_interval_in_whole_cycles():
    stamps = (0.0, 1.7, 3.71, 5.7, 7.71, 7.9)
    decisions = [decided({}, time)._replace(goal="g") for time in stamps]
    assert decision_period(Recorded(decisions=decisions)) == 2.0


def test_a_bag_with_fewer_scans_than_the_node_got_has_the_nodes_observations(tmp_path):
    drive = record(tmp_path / "a.bag", scan=lambda ranges, k: ranges if k % 2 or not k else None)
    (trajectory,), skipped = rebuild(tmp_path / "a.bag")
    assert_equal(trajectory, drive)
    assert skipped == {}


@pytest.mark.parametrize("seconds", [0.8, 5.0])
def test_the_period_is_that_of_the_recorded_decisions(tmp_path, seconds):
    """Rewards scale with the period, as in training. A course of two decisions uses the period of
    the other course.
    """
    with Messages(tmp_path / "a.bag") as writer:
        drives = [
            Drive(
                writer,
                begin=begin,
                seconds=(count - 0.5) * seconds,
                goal="g%d" % count,
                every=int(50 * seconds),
            )
            for begin, count in ((10.0, 4), (60.0, 2))
        ]
    rebuilt, skipped = rebuild(tmp_path / "a.bag", reward=Reward(c_p=0.0, c_c=0.0))
    assert skipped == {}
    for drive, trajectory, count in zip(drives, rebuilt, (4, 2)):
        assert_equal(trajectory, drive, count)
        np.testing.assert_allclose(
            trajectory.reward, [-seconds / 2] * (count - 1) + [0.0], atol=1e-6
        )


class PublishesEnd(Drive):
    """Drive whose node publishes its observation at the end of the course."""

    def end(self, t):
        self.observations.append(Context.of(self.theta, self.seen(), SPACE, LAYOUT).observation)
        self.writer.decision(
            t + 0.2, self.number, self.goal, self.seen(), SPACE.as_dict(self.theta)
        )


@pytest.mark.parametrize(
    ("kind", "status", "seconds", "finish", "count", "terminated", "skipped"),
    [
        (Drive, GAVE_UP, 9.0, None, 5, True, {}),
        (Drive, REJECTED, 9.0, None, 5, True, {}),
        (Drive, PREEMPTED, 9.0, None, 4, False, {}),
        (Drive, PREEMPTED, 9.98, None, 4, False, {}),
        (Drive, None, 9.0, None, 4, False, {}),
        (
            Drive,
            PREEMPTED,
            9.0,
            3.5,
            4,
            True,
            {},
        ),  # The finish line is reached before the goal, at 0.5 m/s after 7 s.
        (PublishesEnd, SUCCEEDED, 9.0, None, 5, True, {}),
        (PublishesEnd, SUCCEEDED, 8.4, None, 5, True, {}),
        (PublishesEnd, PREEMPTED, 9.8, None, 5, False, {}),
        (
            PublishesEnd,
            PREEMPTED,
            8.4,
            None,
            4,
            False,
            {"a course was interrupted soon after a decision": 1},
        ),
        (PublishesEnd, None, 9.8, None, 5, False, {}),  # The node was switched off.
    ],
)
def test_each_end_of_a_course_gives_its_transitions(
    tmp_path, kind, status, seconds, finish, count, terminated, skipped
):
    """If the node does not publish its observation at the end, the observation of the last decision
    is used.
    """
    drive = record(tmp_path / "a.bag", kind, status=status, seconds=seconds)
    (trajectory,), why = rebuild(tmp_path / "a.bag", finish=finish)
    assert (trajectory.terminated, why) == (terminated, skipped)
    assert_equal(trajectory, drive, count, ends=terminated and kind is Drive)
    # No time cost at the goal.
    assert (trajectory.reward[-1] > 0.0) == (status == SUCCEEDED or finish is not None)


def test_a_course_ends_with_its_result_or_with_its_status_whichever_is_earlier(tmp_path):
    ends = []
    for result in (8.0, 12.0):
        path = tmp_path / f"{result}.bag"
        with Messages(path) as writer:
            writer.status(1.0, "g")
            writer.status(11.0, "g", running=False)
            writer.result(result, "g", SUCCEEDED)
        (goal,) = read(path).goals
        assert goal.status == "reached"
        ends.append(goal.end)
    assert ends == [7.0, 10.0]


def test_a_goal_that_is_being_cancelled_is_still_pursued(tmp_path):
    with Messages(tmp_path / "a.bag") as writer:
        for at, code in ((10.0, ACTIVE), (11.0, PREEMPTING), (12.0, PREEMPTED)):
            writer.status(at, "g", running=False, ended=code)
    (goal,) = read(tmp_path / "a.bag").goals
    assert (goal.begin, goal.end) == (0.0, 2.0)


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


def test_a_node_that_is_switched_off_and_on_leaves_a_gap(tmp_path):
    """The node stops after 3.8 s and decides again from 6 s on."""

    class Switched(Drive):
        def decide(self, t):
            if t == pytest.approx(14.0):
                self.writer.decision(
                    t - 0.2, self.number, self.goal, self.seen(), SPACE.as_dict(self.theta)
                )
            else:
                super().decide(t)

    record(tmp_path / "a.bag", Switched)
    rebuilt, skipped = rebuild(tmp_path / "a.bag")
    assert [len(t) for t in rebuilt] == [2, 2]
    assert [t.terminated for t in rebuilt] == [False, True]
    assert skipped == {}


@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_a_bag_converted_by_rosbags_convert_gives_the_same_transitions(tmp_path, storage):
    drive = record(tmp_path / "a.bag")
    command = Path(sys.executable).with_name("rosbags-convert")
    for source, destination in (("a.bag", "ros2"), ("ros2", "back.bag")):
        words = [
            "--src",
            tmp_path / source,
            "--dst",
            tmp_path / destination,
            "--dst-storage",
            storage,
        ]
        subprocess.run([command, *words], check=True)
    # One bag, although the folder has several files.
    assert bags_in([tmp_path / "ros2"]) == [tmp_path / "ros2"]
    assert bags_in([tmp_path]) == [tmp_path / name for name in ("a.bag", "back.bag", "ros2")]
    (lone,) = (file for file in (tmp_path / "ros2").iterdir() if file.name != "metadata.yaml")
    shutil.copy(lone, tmp_path)
    (expected,), _ = rebuild(tmp_path / "a.bag")
    assert_equal(expected, drive)
    for number, name in enumerate(["ros2", "back.bag", lone.name]):
        out = tmp_path / ("out%d" % number)
        assert bags_to_dataset.main([str(tmp_path / name), "--out", str(out)]) == 0
        (stored,) = Dataset(out).trajectories()
        for array in ("scan", "rest", "action", "reward"):
            assert getattr(stored, array).tobytes() == getattr(expected, array).tobytes()


def test_code_in_a_message_definition_is_not_run(tmp_path):
    """ROS's own rosbag generates Python code from the name of such a constant."""
    code = f"uint8 {{0:open('{tmp_path}/ran','w')}}[0]=5\nbool data\n"
    for number, definition in enumerate(
        (code, code.replace("[0]=5", "=5"), f"string A={code[6:]}")
    ):
        with Writer(tmp_path / f"{number}.bag") as writer:
            scan = writer.add_connection(
                "/front/scan", "std_msgs/msg/Bool", msgdef=definition, md5sum="1" * 32
            )
            writer.write(scan, SECOND, b"\1")
        with pytest.raises(AnyReaderError):
            read(tmp_path / f"{number}.bag")
    assert not (tmp_path / "ran").exists()


@pytest.mark.fault("18d")
def test_a_stopped_demonstration_leaves_no_bag(tmp_path, monkeypatch):
    monkeypatch.setattr(Demonstrator, "command", Mock(side_effect=KeyboardInterrupt))
    arguments = [str(tmp_path / "part.bag"), "--world", "generated:0", "--simulator", "kinematic"]
    assert demonstrate.main(arguments) == 130
    assert not list(tmp_path.iterdir())


@pytest.mark.fault("18")
def test_fault_18_bags_that_lack_something_are_skipped_and_counted(tmp_path, capsys):
    record(tmp_path / "whole.bag")
    (tmp_path / "cut_short.bag").write_bytes((tmp_path / "whole.bag").read_bytes()[:5000])
    (tmp_path / "text.bag").write_text("no bag at all\n" * 100)
    with Messages(tmp_path / "nothing.bag"):
        pass
    reasons = {
        "cut_short.bag": "index looks damaged",
        "text.bag": "magic is invalid",
        "nothing.bag": "no decisions",
    }
    for missing, reason in (
        ("scan", "no scans"),
        ("odometry", "no odometry"),
        ("status", "no goals on /move_base/status"),
        ("decision", "no decisions"),
    ):
        record(tmp_path / f"no_{missing}.bag", without=(missing,))
        reasons[f"no_{missing}.bag"] = reason
    assert bags_to_dataset.main([str(tmp_path), "--out", str(tmp_path / "out")]) == 0
    dataset = Dataset(tmp_path / "out")
    source = dataset.about
    bags = {bag["name"]: bag for bag in source["bags"]}
    assert (source["robot"], source["decision_period"]) == ("jackal", 2.0)
    assert (bags.pop("whole.bag")["transitions"], dataset.transitions) == (5, 5)
    assert bags.keys() == reasons.keys()
    for name, reason in reasons.items():
        assert any(reason in text for text in bags[name]["skipped"]), bags[name]
    assert sum(source["skipped"].values()) >= len(reasons)
    assert bags_to_dataset.main([str(tmp_path), "--out", str(tmp_path / "out")]) == 1
    assert "already" in capsys.readouterr().err


def test_only_the_courses_around_a_clock_jump_are_lost(tmp_path):
    with Messages(tmp_path / "a.bag") as writer:
        first = Drive(writer, begin=10.0, goal="before", seed=1)
        Drive(writer, begin=40.0, goal="torn", seed=2, seconds=9.0)
        # The clock jumped back to 43 s.
        Drive(writer, begin=43.0, goal="again", seed=3, seconds=9.0)
    (trajectory,), skipped = rebuild(tmp_path / "a.bag")
    assert_equal(trajectory, first)
    assert "the odometry jumped" in skipped


def person(drive, t, k):
    if k == 275:  # A person changes a parameter in the middle of the third decision.
        drive.theta = SPACE.from_dict({"max_vel_x": 1.23})


def jump(drive, t, k):
    if k == 250:
        drive.writer.odometry(t + 0.001, (5.0, 5.0, 0.0), (0.0, 0.0))


class Misses(Drive):
    """Drive whose node misses the third decision."""

    def decide(self, t):
        if t != 14.0:
            super().decide(t)


@pytest.mark.parametrize(
    ("changes", "lengths", "reason"),
    [  # Each change happens during the third decision.
        (
            {"scan": lambda ranges, k: None if 230 < k < 290 else ranges},
            [2, 2],
            "scans are missing",
        ),
        ({"after": jump}, [], "the odometry jumped"),
        ({"after": person}, [2, 2], "parameters were changed"),
        ({"kind": Misses}, [1, 2], "a decision's period differs from the others"),
    ],
    ids=["gap", "moved", "person", "missed"],
)
def test_gaps_jumps_and_changes_cut_an_episode(tmp_path, changes, lengths, reason):
    record(tmp_path / "a.bag", **changes)
    rebuilt, skipped = rebuild(tmp_path / "a.bag")
    assert [len(t) for t in rebuilt] == lengths, skipped
    assert any(reason in text for text in skipped), skipped
    assert [t.terminated for t in rebuilt] == [False, True][: len(rebuilt)]


@pytest.mark.parametrize(
    ("seconds", "moved", "jumps"),
    [(0.1, 0.79, False), (0.1, 0.81, True), (2.0, 10.2, False), (2.0, 10.4, True)],
)
def test_odometry_jumps_if_it_moves_more_than_thirty_centimetres_beyond_five_metres_a_second(
    seconds, moved, jumps
):
    stamps = np.array([0.0, seconds])
    pose = np.array([[1.0, 2.0, 0.0], [1.0, 2.0 - moved, 0.0]])
    recorded = Recorded(odometry=Motion(stamps, stamps, pose, np.zeros((2, 2))))
    with pytest.raises(Skipped, match="the odometry jumped") if jumps else nullcontext():
        check_motion(recorded, Goal("g", 0.0, seconds))


def test_a_contact_is_charged_in_its_decision(tmp_path):
    record(
        tmp_path / "a.bag", after=lambda drive, t, k: k in (250, 260) and drive.writer.contact(t)
    )
    (plain,), _ = rebuild(tmp_path / "a.bag")
    (charged,), _ = rebuild(tmp_path / "a.bag", reward=Reward(c_collision=3.0))
    np.testing.assert_allclose(charged.reward - plain.reward, [0, 0, -3, 0, 0], atol=1e-6)


def test_rewards_have_the_scale_and_pace_of_the_encoding(tmp_path):
    """For a base of half the Jackal's speed, time costs half as much."""
    record(tmp_path / "a.bag")
    slow = replace(robots.JACKAL, base=robots.JACKAL.base.model_copy(update={"max_speed": 1.0}))
    for robot, cost in ((robots.JACKAL, -1.0), (slow, -0.5)):
        options = {"observation": "dimensionless", "reward": Reward(c_p=0.0, c_c=0.0)}
        (trajectory,), _ = rebuild(tmp_path / "a.bag", robot, **options)
        assert trajectory.reward.tolist() == pytest.approx([cost] * 4 + [0.0])


def test_a_recipe_sets_encoding_and_reward_and_training_refuses_others(tmp_path, capsys):
    record(tmp_path / "a.bag")
    data = str(tmp_path / "data")
    recipe = tmp_path / "own.yaml"
    recipe.write_text(RECIPES["jackal"].read_text().replace("lowest: true", "lowest: false"))
    assert (
        bags_to_dataset.main([str(tmp_path / "a.bag"), "--out", data, "--recipe", str(recipe)]) == 0
    )
    source = Dataset(data).about
    assert (source["observation"], source["robot"], source["decision_period"]) == (
        "dimensionless",
        "jackal",
        2.0,
    )
    assert (source["failure_seconds"], source["exact_time"], source["lowest"]) == (
        11.0,
        True,
        False,
    )
    base = [
        "--dataset",
        data,
        "--recipe",
        "jackal",
        "--decision-period",
        "2",
        "--out",
        str(tmp_path / "run"),
    ]
    known = [*base, "--no-critics-know-more"]
    for options, line in (
        (base, "critics_know_more is True, but the .*data was driven with False: give the same"),
        (known, "lowest is True, but the dataset .*data was driven with False: give the same"),
    ):
        config = config_of(options)
        with pytest.raises(ApplrError, match=line):
            dataset_of(config)
    assert dataset_of(config_of([*known, "--no-lowest"])).transitions == 5


def zeros(ranges, k):
    """Return 0 for beams without a return, as some lasers do, and only zeros between the third and
    fourth decision.
    """
    ranges = np.where(np.arange(720) % 7, 1.6, 0.0)
    return np.zeros(720) if 210 < k < 390 and k % 100 else ranges


@pytest.mark.parametrize(
    ("scan", "lowest", "nearest"),
    [
        (zeros, False, 1.6),
        (zeros, True, 1.6),
        (lambda ranges, k: np.full(720, -np.inf), False, 0.4),
    ],
)
def test_the_clearance_term_uses_the_smallest_range(tmp_path, scan, lowest, nearest):
    """A range of -inf is too near to measure and counts as the laser's minimum range."""
    record(tmp_path / "a.bag", scan=scan)
    robot = replace(robots.JACKAL, laser=robots.JACKAL.laser.model_copy(update={"range_min": 0.4}))
    (trajectory,), skipped = rebuild(
        tmp_path / "a.bag", robot, reward=Reward(c_f=0.0, c_p=0.0, lowest=lowest)
    )
    assert skipped == {}
    np.testing.assert_allclose(trajectory.reward, -0.05 / nearest, rtol=1e-5)


class ExactOdometry(KinematicSimulator):
    """Simulator without odometry drift."""

    def advance(self, seconds):
        state = super().advance(seconds)
        self.set_odometry(self.to_odom(state.pose))
        return self.state


def driven(path, observation, world, time_limit, **settings):
    """Drive two courses in a world, record them in a bag, and return the environment's transitions.

    The environment rewards true progress to the course's goal; from a bag, only odometry and the
    sent goal are known. So the odometry is exact here, and the course has its goal where the goal
    is sent.
    """
    settings.update(observation=observation, period=1.0, movers=True)
    loaded = worlds.load(world)
    near = replace(loaded.course, goal=loaded.course.sent_goal)
    env = ApplrEnv([replace(loaded, course=near)], **settings)
    simulator = ExactOdometry(scan_noise=0.0)
    env.episode = Episode(
        simulator, env.episode.move_base, period=1.0, time_limit=time_limit, record=True
    )
    env.episode.layout = env.encoding.layout
    layout = TransitionLayout.of(env.encoding)
    assert layout == env.layout
    rng = np.random.default_rng(3)
    trajectories = []
    drives = []
    moving = 0
    for course in range(2):
        seen = [env.reset(seed=course)[0]]
        over = False
        actions = []
        rewards = []
        while not over:
            wanted = env.encoding.action(env.space.theta0) + rng.uniform(
                -0.4, 0.8, env.encoding.actions
            )
            observed, reward, terminated, truncated, _ = env.step(wanted)
            seen = [*seen, observed]
            rewards = [*rewards, reward]
            over = terminated or truncated
            actions.append(env.encoding.action(env.episode.outcome.theta))
            moving += len(env.episode.seen().movers)
        trajectories.append(Trajectory.of(layout, seen, actions, rewards, terminated))
        drives.append(env.episode.drive)
    assert moving or "dynamic" not in world
    write(path, *drives)
    return trajectories


def assert_same(rebuilt, expected):
    """Compare transitions field by field. A beam between two steps of the scan's resolution may
    differ by one step.
    """
    assert (len(rebuilt), rebuilt.terminated) == (len(expected), expected.terminated)
    assert np.abs(rebuilt.scan.astype(int) - expected.scan).max() <= 1
    assert (rebuilt.scan != expected.scan).mean() < 1e-4
    for name, most in (("rest", 1e-6), ("action", 1e-6), ("reward", 1e-5)):
        np.testing.assert_allclose(
            getattr(rebuilt, name), getattr(expected, name), rtol=0.0, atol=most, err_msg=name
        )


@pytest.mark.parametrize("observation", ["paper", "dimensionless"])
@pytest.mark.parametrize(("world", "limit"), [("generated:2", 100.0), ("dynamic:406", 9.0)])
def test_a_recorded_drive_equals_the_environments_transitions(tmp_path, observation, world, limit):
    """Covers the command, both encodings, moving obstacles, and ends at goal and time limit."""
    expected = driven(
        tmp_path / "a.bag", observation, world, limit, reward={"lowest": True, "exact_time": True}
    )
    recipe = tmp_path / "own.yaml"
    recipe.write_text(f"observation: {observation}\nlowest: true\nexact_time: true\n")
    options = ["--recipe", str(recipe), "--out", str(tmp_path / "data")]
    assert bags_to_dataset.main([str(tmp_path / "a.bag"), *options]) == 0
    dataset = Dataset(tmp_path / "data")
    assert dataset.about["observation"] == observation
    assert dataset.about["skipped"] == {}
    for rebuilt, whole in zip(dataset.trajectories(), expected, strict=True):
        assert_same(rebuilt, whole)


@pytest.mark.fault("23a")
@pytest.mark.parametrize(
    ("command", "arguments", "word"),
    [
        (appld, ["x.bag", "--out", "x.safetensors", "--seed", "-1"], "--seed"),
        (appld, ["nowhere.bag", "--out", "x.safetensors"], "nowhere.bag"),
        (bags_to_dataset, ["x.bag"], "--out"),
        (bags_to_dataset, ["nowhere.bag", "--out", "out"], "nowhere.bag"),
        (bags_to_dataset, ["x.bag", "--out", "out", "--recipe", "none"], "none"),
        (demonstrate, ["x.bag", "--seed", "-1"], "--seed"),
        (tune_robot, ["jackal", "--minutes", "0"], "--minutes"),
    ],
)
def test_mistakes_on_the_other_command_lines_are_one_line(
    command, arguments, word, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    assert command.main(arguments) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert word in error
    assert not list(tmp_path.iterdir())
