"""Bags to transitions: rebuilt as the node saw them, from ROS 1 and ROS 2 bags, and whatever is damaged left out."""

import shutil
import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from rosbags import rosbag2
from rosbags.convert import convert
from rosbags.highlevel import AnyReader
from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag1 import Reader, Writer
from rosbags.rosbag2 import StoragePlugin

from applr_ros1 import robots
from applr_ros1.common.angles import transform_point
from applr_ros1.common.files import StorageError
from applr_ros1.policy.dimensionless import DimensionlessForm
from applr_ros1.policy.form import PaperForm
from applr_ros1.policy.observation import LAYOUT, goal_angle, local_goal, observe
from applr_ros1.policy.parameter_space import SPACE, THETA_0
from tests.support.recording import ABORTED, PREEMPTED, SUCCEEDED, RecordingEpisode, StackWriter
from training import bags_to_dataset
from training.bags.episodes import BagReport, decision_period, trajectories
from training.bags.reader import SECOND, BagError, _is_right, find, read_bag
from training.env.reward import Reward
from training.replay.store import TrajectoryStore
from training.replay.trajectory import TransitionLayout


class Drive:
    """A synthetic drive of 50 Hz along x: what was written, and what a node would have seen.

    without: topics that are left out; scan(ranges, k): what the laser says instead in step k, None for nothing;
    after(drive, t, k): is called after each step.
    """

    def __init__(
        self,
        writer,
        *,
        begin=10.0,
        seconds=9.0,
        node=True,
        status=SUCCEEDED,
        seed=0,
        without=(),
        goal="g",
        every=100,
        layout=LAYOUT,
        scan=lambda ranges, k: ranges,
        after=lambda drive, t, k: None,
    ):
        self.writer, self.node, self.goal, self.without, self.every, self.heard = (
            writer,
            node,
            goal,
            without,
            every,
            scan,
        )
        self.rng, self.layout = np.random.default_rng(seed), layout
        self.observations, self.thetas, self.number = [], [], 0
        self.theta = THETA_0
        self.announce(begin)
        self.plan = np.column_stack([np.linspace(0, 10, 200), np.sin(np.linspace(0, 3, 200)), np.zeros(200)])
        steps = int(round(seconds * 50))
        if "goal" not in without:
            writer.goal(begin, (10.0, 0.1, 0.0))
        for k in range(steps + 1):
            self.step(begin + 0.02 * k, k)
            after(self, begin + 0.02 * k, k)
        end = begin + 0.02 * steps
        self.see(end)
        if status is not None:
            writer.result(end, goal, status)
            writer.status(end, goal, running=False)

    def step(self, t, k):
        w = self.writer
        if k % 10 == 0 and "status" not in self.without:
            w.status(t, self.goal)
        if k % 5 == 0 and "plan" not in self.without:
            self.write_plan(t)
        self.pose = (0.01 * k, 0.1, self.yaw(k))
        if "odometry" not in self.without:
            w.odometry(t, self.pose, (0.5, 0.0))
        self.ranges = self.rng.uniform(0.3, 3.0, 720).astype(np.float32)
        heard = self.heard(self.ranges, k)
        if heard is not None:
            self.newest = self.ranges, self.pose
            if "scan" not in self.without:
                w.scan(t, heard)
        if k % self.every == 0:
            self.decide(t)

    def yaw(self, k):
        return 0.2 * np.sin(0.01 * k)

    def write_plan(self, t):
        self.writer.plan(t, self.plan)

    def see(self, t):
        self.observations.append(self.seen(LAYOUT))

    def seen(self, layout):
        (ranges, pose), laser = self.newest, robots.JACKAL.laser
        phi = goal_angle(local_goal(self.plan, pose, layout.lookahead))
        return observe(layout.resample(ranges, laser.first_angle, laser.increment), phi, self.theta, layout=layout)

    def decide(self, t):
        self.see(t)
        seen_by_node = self.seen(self.layout)
        self.number += 1
        before, self.theta = self.theta, SPACE.to_theta(self.rng.uniform(-1, 1, len(SPACE)))
        if self.node:
            seen, sets = dict.fromkeys(("scan", "odometry", "plan"), t), map(SPACE.as_dict, (before, self.theta))
            self.writer.decision(t, self.number, self.goal, seen_by_node, seen, *sets)
        self.thetas.append(self.theta)
        self.announce(t + 0.01)

    def announce(self, t):
        for server, values in SPACE.requests(self.theta).items():
            if server not in self.without:
                self.writer.parameters(t, server, values)


def record(path, kind=Drive, **options):
    with StackWriter(path) as writer:
        return kind(writer, **options)


def rebuild(path, **options):
    report = BagReport()
    return list(trajectories(read_bag(path), report=report, **options)), report


def assert_equal(trajectory, drive, count=None, ends=True):
    """The trajectory is what the node saw and did; `ends`: its last observation, too."""
    count = len(drive.thetas) if count is None else count
    assert len(trajectory) == count
    layout = TransitionLayout()
    expected = np.array(drive.observations[: count + 1])
    last = count + ends
    np.testing.assert_array_equal(trajectory.scan[:last], layout.quantise(expected[:last]))
    np.testing.assert_allclose(trajectory.rest[:last], expected[:last, 720:], atol=1e-6)
    actions = [PaperForm(robots.JACKAL).action(theta) for theta in drive.thetas[:count]]
    np.testing.assert_allclose(trajectory.action, actions, atol=1e-6)


@pytest.mark.parametrize("node", [True, False])
def test_transitions_are_what_the_node_saw(tmp_path, node):
    drive = record(tmp_path / "a.bag", node=node)
    (trajectory,), report = rebuild(tmp_path / "a.bag")
    assert_equal(trajectory, drive)
    assert trajectory.terminated
    assert trajectory.info["success"]
    assert report.skipped == {}
    assert report.verified == (5 if node else 0)
    # R_f = -1 until the goal; R_p the metres towards it; R_c = -.05 / nearest range
    nearest = 1.0 + (trajectory.scan[1:].min(axis=1) * TransitionLayout().step - 1.0)
    expected = np.array([-1, -1, -1, -1, 0]) + np.array([1, 1, 1, 1, 0.5]) - 0.05 / nearest
    np.testing.assert_allclose(trajectory.reward, expected, atol=0.02)


class Turning(Drive):
    """Turns at 1 rad/s, and its plan is in the map."""

    FRAME = (1.0, 2.0, 0.5)  # of the odometry in the map

    def yaw(self, k):
        return 0.02 * k

    def write_plan(self, t):
        self.writer.transform(t, "map", self.writer.robot.frames.odom, self.FRAME)
        x, y = transform_point(self.FRAME, *self.plan[:, :2].T)
        self.writer.plan(t, np.column_stack([x, y, self.plan[:, 2]]), "map")


def test_a_turning_robot_sees_its_plan_in_the_map_from_where_its_scan_was_taken(tmp_path):
    """Scans are 60 ms old when a decision is made."""
    drive = record(
        tmp_path / "a.bag", Turning, node=False, scan=lambda ranges, k: ranges if k == 0 or k % 5 == 2 else None
    )
    (trajectory,), report = rebuild(tmp_path / "a.bag")
    assert report.skipped == {}
    assert_equal(trajectory, drive)


def test_the_period_is_the_median_interval_in_whole_cycles():
    stamps = (0.0, 1.7, 3.71, 5.7, 7.71, 7.9)
    decisions = [{"goal": "g", "stamp": int(stamp * SECOND)} for stamp in stamps]
    assert decision_period(SimpleNamespace(decisions=decisions, end=9 * SECOND)) == 2.0


def test_a_policy_in_another_form_is_compared_by_what_it_sees(tmp_path):
    layout = DimensionlessForm(robots.JACKAL, 2.0).layout
    drive = record(tmp_path / "a.bag", layout=layout)
    (trajectory,), report = rebuild(tmp_path / "a.bag")
    assert_equal(trajectory, drive)
    assert report.verified == 5
    record(tmp_path / "b.bag", layout=replace(layout, range_cap=4.0))
    _, report = rebuild(tmp_path / "b.bag")
    assert report.skipped == {"a rebuilt observation differs from the node's": 5}


def test_a_bag_without_the_scans_of_decisions_has_those_before_them(tmp_path):
    drive = record(tmp_path / "a.bag", scan=lambda ranges, k: ranges if k % 2 or not k else None)
    (trajectory,), report = rebuild(tmp_path / "a.bag")
    actions = [PaperForm(robots.JACKAL).action(theta) for theta in drive.thetas]
    np.testing.assert_allclose(trajectory.action, actions, atol=1e-6)
    assert (len(trajectory), report.verified) == (5, 1)


def test_what_no_server_has_said_is_as_in_the_robots_files(tmp_path, capsys):
    """A plain move_base, of whose servers somebody recorded one, or none."""
    for name, silent in (("a", ("local_costmap", "global_costmap", "TrajectoryPlannerROS")), ("b", SPACE.servers)):
        record(tmp_path / f"{name}.bag", node=False, without=silent)
        (trajectory,), _ = rebuild(tmp_path / f"{name}.bag")
        said = ~np.isclose(trajectory.action, PaperForm(robots.JACKAL).action(THETA_0), atol=1e-6)
        inflation = SPACE.chosen.names.index("inflation_radius")
        assert said.any(axis=0).nonzero()[0].tolist() == ([inflation] if name == "a" else [])
    assert bags_to_dataset.main([str(tmp_path / "a.bag"), "--out", str(tmp_path / "out")]) == 0
    line = "a.bag: no parameter_updates of TrajectoryPlannerROS, local_costmap: values of the robot's files are taken"
    assert line in capsys.readouterr().out


@pytest.mark.parametrize("seconds", [0.8, 5.0])
def test_the_period_is_that_of_the_recorded_decisions(tmp_path, seconds):
    """Rewards count time in it, as in training; a course of two decisions takes it from the bag's other course."""
    with StackWriter(tmp_path / "a.bag") as writer:
        drives = [
            Drive(writer, begin=begin, seconds=(count - 0.5) * seconds, goal="g%d" % count, every=int(50 * seconds))
            for begin, count in ((10.0, 4), (60.0, 2))
        ]
    rebuilt, report = rebuild(tmp_path / "a.bag", reward=Reward(c_p=0.0, c_c=0.0))
    assert report.skipped == {}
    for drive, trajectory, count in zip(drives, rebuilt, (4, 2)):
        assert_equal(trajectory, drive, count)
        np.testing.assert_allclose(trajectory.reward, [-seconds / 2] * (count - 1) + [0.0], atol=1e-6)


@pytest.mark.parametrize(
    ("status", "seconds", "finish", "count", "terminated"),
    [
        (ABORTED, 9.0, None, 5, True),
        (PREEMPTED, 9.0, None, 4, False),
        (PREEMPTED, 9.98, None, 5, False),
        (None, 9.0, None, 4, False),
        (PREEMPTED, 9.0, 3.5, 4, True),  # a finish line before the goal, at 0.5 m/s after 7 s
    ],
)
def test_how_a_course_ends(tmp_path, status, seconds, finish, count, terminated):
    drive = record(tmp_path / "a.bag", status=status, seconds=seconds)
    (trajectory,), _ = rebuild(tmp_path / "a.bag", **({"finish": finish} if finish else {}))
    assert trajectory.terminated == terminated
    assert trajectory.info["success"] == (finish is not None)
    assert_equal(trajectory, drive, count, ends=finish is None)


def test_the_status_says_how_a_course_ended_where_no_result_was_recorded(tmp_path):
    def end(drive, t, k):
        if k >= 450:
            drive.writer.status(t + 0.01, "g", running=False, ended=SUCCEEDED)

    record(tmp_path / "a.bag", status=None, after=end)
    (trajectory,), _ = rebuild(tmp_path / "a.bag")
    assert trajectory.terminated
    assert trajectory.info["success"]


@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_converted_bags_give_the_same_transitions(tmp_path, storage):
    drive = record(tmp_path / "a.bag")
    for source, destination in (("a.bag", "ros2"), ("ros2", "back.bag")):
        how = storage, 9, None, "none", None, None, (), (), (), ()
        convert([tmp_path / source], tmp_path / destination, *how)
    assert find([tmp_path / "ros2"]) == [tmp_path / "ros2"]  # one bag, whatever files it consists of
    converted = ["ros2", "back.bag"]
    if storage == "mcap":
        lone = tmp_path / "lone" / "deep"
        shutil.copytree(tmp_path / "ros2", lone)
        (lone / "metadata.yaml").unlink()
        (file,) = find([tmp_path / "lone"])
        assert file == next(lone.glob("*.mcap"))
        converted.append(file)
    (expected,), _ = rebuild(tmp_path / "a.bag")
    assert_equal(expected, drive)
    for number, name in enumerate(converted):
        (trajectory,), report = rebuild(tmp_path / name)
        assert report.verified == 5
        out = tmp_path / ("out%d" % number)
        assert bags_to_dataset.main([str(tmp_path / name), "--out", str(out)]) == 0
        ((_, stored),) = TrajectoryStore(out).trajectories()
        for array in ("scan", "rest", "action", "reward"):
            np.testing.assert_array_equal(getattr(trajectory, array), getattr(expected, array))
            np.testing.assert_array_equal(getattr(stored, array), getattr(expected, array))


def damaged(tmp_path):
    """{file name: its reason for being left out, as counted}"""
    record(tmp_path / "whole.bag")
    whole = (tmp_path / "whole.bag").read_bytes()
    (tmp_path / "cut_end.bag").write_bytes(whole[:-200])  # all messages are there
    broken = {
        "truncated.bag": whole[:5000],
        "text.bag": b"no bag at all\n" * 100,
        "run.bag.active": whole[:5000],
        "noise.bag": whole[:20000] + bytes(400) + whole[20400:],
    }
    for name, content in {**broken, "empty.bag": b""}.items():
        (tmp_path / name).write_bytes(content)
    with StackWriter(tmp_path / "nothing.bag"):
        pass
    reasons = {**dict.fromkeys(broken, "damaged"), "empty.bag": "empty file", "nothing.bag": "no messages"}
    for missing, reason in (
        ("scan", "no scans"),
        ("odometry", "no odometry"),
        ("status", "no goal was pursued"),
        ("plan", "no global plan"),
        ("goal", "the goal's position"),
    ):
        record(tmp_path / ("no_%s.bag" % missing), without=(missing,), node=False)
        reasons["no_%s.bag" % missing] = reason
    return reasons


ODD = {
    "shapeshifter": ("x_msgs/msg/Anything", "Definition of x_msgs/Anything"),
    "cut": ("x_msgs/msg/State", "# state\nsensor_msgs/Imu imu\nx_msgs/Meas"),
    "empty": ("x_msgs/msg/Packet", ""),
    "windows": ("x_msgs/msg/Pair", "uint8 a\r\nuint8 b\r\n"),
}


def with_definition(path, topic, kind, text):
    """A copy of whole.bag beside it, with a topic that has this definition."""
    with Reader(path.parent / "whole.bag") as reader, Writer(path) as writer:
        new = {
            c.id: writer.add_connection(c.topic, c.msgtype, msgdef=c.msgdef.data, md5sum=c.digest)
            for c in reader.connections
            if c.topic != topic
        }
        odd = writer.add_connection(topic, kind, msgdef=text, md5sum="1" * 32)
        for connection, time, raw in reader.messages():
            writer.write(new.get(connection.id, odd), time, raw)
        writer.write(odd, time, b"\0" * 4)


@pytest.mark.parametrize("name", ODD)
def test_only_the_definitions_of_needed_topics_decide(tmp_path, name):
    record(tmp_path / "whole.bag")
    with_definition(tmp_path / "odd.bag", "/odd", *ODD[name])
    (trajectory,), _ = rebuild(tmp_path / "odd.bag")
    assert len(trajectory) == 5
    with_definition(tmp_path / "needed.bag", "/cmd_vel", *ODD[name])
    with pytest.raises(BagError, match=f"/cmd_vel is {ODD[name][0]}, whose message definition in the bag is wrong"):
        rebuild(tmp_path / "needed.bag")


PARTS = "=" * 80 + "\nMSG: x_msgs/B\n"


@pytest.mark.parametrize(
    ("text", "right"),
    [
        ("float64[36] covariance\nuint8[] data", True),
        ("x_msgs/B result\n" + PARTS, True),  # such as MoveBaseResult
        ("string[1001] names", False),
        ("x_msgs/B[] results\n" + PARTS, False),  # a message says how many
        ("x_msgs/B[2] results\n" + PARTS + "x_msgs/C c\n" + PARTS.replace("B", "C"), False),
        ("# " + "x" * 70_000 + "\nuint8 a", False),
        ("uint8 A = 1\n", False),
    ],
)
def test_a_definition_that_asks_for_endless_work_is_wrong(text, right):
    kind = MessageDefinitionFormat.IDL if "=" in text and "A" in text else MessageDefinitionFormat.MSG
    connection = SimpleNamespace(msgdef=MessageDefinition(kind, text), msgtype="x_msgs/msg/A", digest="")
    assert _is_right(connection, False) is right


def test_databases_and_settings_of_ros_2_bags_are_plain(tmp_path):
    """A view can be endless; the settings of a topic are YAML in YAML."""
    record(tmp_path / "whole.bag")
    convert([tmp_path / "whole.bag"], tmp_path / "whole", "sqlite3", 9, None, "none", None, None, (), (), (), ())
    endless = "".join(f"a{k + 1}: &a{k + 1} {{<<: [*a{k}, *a{k}]}}\n" for k in range(60))
    with closing(sqlite3.connect(next((tmp_path / "whole").glob("*.db3")))) as database, database:
        database.execute("UPDATE topics SET offered_qos_profiles = ?", ("a0: &a0 {x: 1}\n" + endless,))
    assert rebuild(tmp_path / "whole")[0]
    with closing(sqlite3.connect(next((tmp_path / "whole").glob("*.db3")))) as database, database:
        database.execute("ALTER TABLE schema RENAME TO before")
        database.execute(
            "CREATE VIEW schema AS WITH RECURSIVE r(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM r) "
            "SELECT MAX(x) AS schema_version FROM r"
        )
    with pytest.raises(BagError, match="it has more than plain tables"):
        rebuild(tmp_path / "whole")


@pytest.mark.parametrize("storage", StoragePlugin)
def test_of_a_ros_2_bag_too(tmp_path, storage):
    record(tmp_path / "whole.bag")
    convert([tmp_path / "whole.bag"], tmp_path / "whole", "sqlite3", 9, None, "none", None, None, (), (), (), ())
    with rosbag2.Reader(tmp_path / "whole") as reader:
        for topic in ("/odd", "/cmd_vel"):
            with rosbag2.Writer(tmp_path / topic[1:], version=9, storage_plugin=storage) as writer:
                new = {
                    c.id: writer.add_connection(c.topic, c.msgtype, msgdef=c.msgdef.data, rihs01=c.digest)
                    for c in reader.connections
                    if c.topic != topic
                }
                kind, text = ODD["cut"]
                odd = writer.add_connection(topic, kind, msgdef=text, rihs01="RIHS01_" + "1" * 64)
                for connection, time, raw in reader.messages():
                    writer.write(new.get(connection.id, odd), time, raw)
                writer.write(odd, time, bytes(8))
    (trajectory,), _ = rebuild(tmp_path / "odd")
    assert len(trajectory) == 5
    with pytest.raises(BagError, match="/cmd_vel is x_msgs/msg/State, whose message definition in the bag is wrong"):
        rebuild(tmp_path / "cmd_vel")


@pytest.mark.fault("18")
def test_fault_18_damaged_bags_are_skipped_and_counted(tmp_path, capsys):
    reasons = damaged(tmp_path)
    assert bags_to_dataset.main([str(tmp_path), "--out", str(tmp_path / "out")]) == 0
    store = TrajectoryStore(tmp_path / "out")
    source = store.about("source")
    said = {bag["name"]: bag for bag in source["bags"]}
    assert (source["robot"], source["decision_period"]) == ("jackal", 2.0)
    assert set(said) == set(reasons) | {"whole.bag", "cut_end.bag"}
    for name in ("whole.bag", "cut_end.bag"):
        assert said[name]["transitions"] == 5
        assert said[name]["skipped"] == {}
    for name, reason in reasons.items():
        if name == "noise.bag" and said[name]["transitions"]:
            continue  # the damage may lie where nothing needed is
        assert said[name]["transitions"] == 0, name
        assert said[name]["skipped"], name
        assert any(reason in text for text in said[name]["skipped"]), (name, said[name]["skipped"])
    assert sum(store.about("skipped").values()) >= len(reasons) - 1
    assert sum(len(t) for _, t in store.trajectories()) == sum(bag["transitions"] for bag in source["bags"])
    assert "Traceback" not in "".join(capsys.readouterr())


def test_a_clock_that_jumps_back_loses_only_its_courses(tmp_path):
    with StackWriter(tmp_path / "a.bag") as writer:
        first = Drive(writer, begin=10.0, goal="before", seed=1)
        Drive(writer, begin=40.0, goal="torn", seed=2, seconds=9.0)
        Drive(writer, begin=43.0, goal="again", seed=3, seconds=9.0)  # the clock fell back to 43 s
    found, report = rebuild(tmp_path / "a.bag")
    assert [t.info["goal"] for t in found] == ["before"]
    assert_equal(found[0], first)
    assert report.skipped


def person(drive, t, k):
    if k == 275:  # turns a knob in the middle of the third decision
        drive.theta = SPACE.from_dict({"max_vel_x": 1.23})
        drive.announce(t)


@pytest.mark.parametrize(
    ("changes", "lengths", "reason"),
    [  # what happens within the third decision
        ({"scan": lambda ranges, k: None if 230 < k < 290 else ranges}, [2, 2], "scans are missing"),
        (
            {"after": lambda d, t, k: k == 250 and d.writer.odometry(t + 0.001, (5.0, 5.0, 0.0), (0.0, 0.0))},
            [],
            "the odometry jumped",
        ),
        ({"after": person}, [2, 2], "parameters were changed"),
        ({"scan": lambda ranges, k: ranges[::2], "node": False}, [], "scan of 360 beams covers"),
        ({"scan": lambda ranges, k: np.full(720, np.nan), "node": False}, [], "beams of the scan are NaN"),
    ],
    ids=["gap", "moved", "person", "coarse", "blind"],
)
def test_gaps_jumps_changes_and_bad_scans_cut_an_episode(tmp_path, changes, lengths, reason):
    record(tmp_path / "a.bag", **changes)
    found, report = rebuild(tmp_path / "a.bag")
    assert [len(t) for t in found] == lengths, report
    assert any(reason in text for text in report.skipped), report
    assert [t.terminated for t in found] == [False, True][: len(found)]


def test_a_node_that_saw_something_else_is_noticed(tmp_path):
    class Other(Drive):
        def seen(self, layout):
            return super().seen(layout) + np.float32(0.01 * (self.number == 2))

    record(tmp_path / "a.bag", Other)
    found, report = rebuild(tmp_path / "a.bag")
    assert report.skipped == {"a rebuilt observation differs from the node's": 1}
    assert [len(t) for t in found] == [1, 2]


def zeros(ranges, k):
    """0 where nothing returns, as some lasers write; nowhere between the third and the fourth decision."""
    ranges = np.where(np.arange(720) % 7, 1.6, 0.0)
    return np.zeros(720) if 210 < k < 390 and k % 100 else ranges


@pytest.mark.parametrize(
    ("scan", "lowest", "nearest"),
    [(zeros, False, 1.6), (zeros, True, 1.6), (lambda ranges, k: np.full(720, -np.inf), False, 0.4)],
)
def test_the_price_of_nearness_is_that_of_the_smallest_range(tmp_path, scan, lowest, nearest):
    """-inf is too near to tell: the robot's smallest range."""
    record(tmp_path / "a.bag", scan=scan, node=False)
    robot = replace(robots.JACKAL, laser=robots.JACKAL.laser.model_copy(update={"range_min": 0.4}))
    report, reward = BagReport(), Reward(c_f=0.0, c_p=0.0, lowest=lowest)
    (trajectory,) = trajectories(read_bag(tmp_path / "a.bag", robot=robot), reward, report=report)
    assert report.skipped == {}
    np.testing.assert_allclose(trajectory.reward, -0.05 / nearest, rtol=1e-5)


def test_plan_and_goal_are_in_the_robots_odometry_frame(tmp_path):
    robot = replace(robots.JACKAL, frames=robots.JACKAL.frames.model_copy(update={"odom": "wheel_odom"}))
    with StackWriter(tmp_path / "a.bag", robot=robot) as writer:
        Drive(writer, seconds=0.0)
        topics = writer.topics.odometry, writer.topics.plan, writer.topics.move_base + "/current_goal"
    with AnyReader([tmp_path / "a.bag"]) as reader:
        found = [(c.topic, reader.deserialize(raw, c.msgtype)) for c, _, raw in reader.messages() if c.topic in topics]
    assert {(topic, message.header.frame_id) for topic, message in found} == {(t, "wheel_odom") for t in topics}


def test_recorded_simulation_equals_the_environment(tmp_path):
    sim_bridge, worlds = pytest.importorskip("sim_bridge"), pytest.importorskip("worlds")
    from applr_ros1.planner.move_base import MoveBase

    rng, form, observations, actions = np.random.default_rng(0), PaperForm(robots.JACKAL), [], []
    with StackWriter(tmp_path / "a.bag") as writer:
        planner = MoveBase(robots.JACKAL.parameters())
        episode = RecordingEpisode(sim_bridge.make("kinematic"), planner, writer, period=2.0, limit=3)
        for course in range(2):
            outcome = episode.reset(worlds.load("generated:%d" % course), course)
            while not outcome.over:
                observations.append(form.observe(episode.context()))
                outcome = episode.decide(SPACE.to_theta(rng.uniform(-1, 1, len(SPACE))))
                actions.append(form.action(outcome.theta))
            observations.append(form.observe(episode.context()))
    found, report = rebuild(tmp_path / "a.bag")
    assert len(actions) == report.transitions
    assert not report.skipped
    np.testing.assert_array_equal(
        np.concatenate([t.scan for t in found]), TransitionLayout().quantise(np.array(observations))
    )
    np.testing.assert_allclose(np.concatenate([t.rest for t in found]), np.array(observations)[:, 720:], atol=1e-6)
    np.testing.assert_allclose(np.concatenate([t.action for t in found]), actions, atol=1e-6)


def test_mistakes_at_the_command_line_are_one_line(tmp_path, capsys):
    record(tmp_path / "a.bag")
    (tmp_path / "none").mkdir()
    bag, out = str(tmp_path / "a.bag"), str(tmp_path / "out")
    for arguments in (
        [str(tmp_path / "missing.bag"), "--out", out],
        [str(tmp_path / "none"), "--out", out],
        [bag, "--out", out, "--reward", "speed=1"],
        [bag, "--out", out, "--reward", "c_p=nan"],
        [bag, "--out", bag],
        [bag, "--out", out, "--scan", "/other"],
    ):
        assert bags_to_dataset.main(arguments) == 1
        printed, error = capsys.readouterr()
        assert error.startswith("bags_to_dataset: "), error
        assert error.count("\n") == 1, error
        assert "missing.bag" not in printed, printed
        assert not (tmp_path / "out").exists(), arguments
    assert bags_to_dataset.main([bag, "--out", out, "__name:=x"]) == 0
    assert bags_to_dataset.main([bag, "--out", out]) == 1  # holds a dataset already
    assert "already" in capsys.readouterr().err


@pytest.mark.fault("21")
def test_writing_where_nothing_can_be_written(tmp_path):
    record(tmp_path / "a.bag")
    for path in (tmp_path / "a.bag", tmp_path / "nowhere" / "b.bag"):
        with pytest.raises(StorageError):
            StackWriter(path)
    with pytest.raises(BagError):
        read_bag(tmp_path / "nowhere.bag")
    assert find([tmp_path]) == [Path(tmp_path / "a.bag")]
