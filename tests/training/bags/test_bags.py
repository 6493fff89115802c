"""Bags to transitions: what the node saw and chose, from ROS 1 and ROS 2 bags, and whatever is damaged left out."""

import shutil
import sqlite3
import subprocess
import sys
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from rosbags import rosbag2
from rosbags.convert import convert
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Reader, Writer
from rosbags.rosbag2 import StoragePlugin

from applr_ros1 import robots
from applr_ros1.common.angles import transform_point
from applr_ros1.common.files import StorageError
from applr_ros1.policy.dimensionless import DimensionlessForm
from applr_ros1.policy.form import PaperForm
from applr_ros1.policy.observation import LAYOUT, observe
from applr_ros1.policy.parameter_space import SPACE, THETA_0
from tests.support.recording import ABORTED, PREEMPTED, SUCCEEDED, RecordingEpisode, StackWriter
from training import bags_to_dataset
from training.bags import SECOND
from training.bags import bag as bags
from training.bags.bag import BagError, bags_in, read
from training.bags.episodes import BagReport, decision_period, transitions
from training.env.reward import Reward
from training.replay.store import TrajectoryStore
from training.replay.trajectory import TransitionLayout


class Drive:
    """A synthetic drive of 50 Hz along x: what was written, and what a node would have seen.

    without: topics that are left out; scan(ranges, k): what the laser says instead in step k, None for nothing;
    after(drive, t, k): is called after each step.
    """

    behind = 0.0  # s by which the odometry that a decision names is older than the decision

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
        steps = int(round(seconds * 50))
        if "goal" not in without:
            self.write_goal(begin, (10.0, 0.1, 0.0))
        for k in range(steps + 1):
            self.step(begin + 0.02 * k, k)
            after(self, begin + 0.02 * k, k)
        end = begin + 0.02 * steps
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
        heard = self.heard(self.ranges, k)
        if heard is not None:
            self.newest = self.ranges
            if "scan" not in self.without:
                w.scan(t, heard)
        if k % self.every == 0:
            self.decide(t)

    def write_goal(self, t, goal):
        self.writer.goal(t, goal)

    def seen(self, layout):
        laser = robots.JACKAL.laser
        ranges = layout.resample(self.newest, laser.first_angle, laser.increment)
        return observe(ranges, 0.01 * self.number, self.theta, layout=layout)

    def decide(self, t):
        self.observations.append(self.seen(LAYOUT))
        seen_by_node = self.seen(self.layout)
        self.number += 1
        before, self.theta = self.theta, SPACE.to_theta(self.rng.uniform(-1, 1, len(SPACE)))
        if self.node:
            seen, sets = {"scan": t, "odometry": t - self.behind}, map(SPACE.as_dict, (before, self.theta))
            self.writer.decision(t, self.number, self.goal, seen_by_node, seen, *sets)
        self.thetas.append(self.theta)


def record(path, kind=Drive, **options):
    with StackWriter(path) as writer:
        return kind(writer, **options)


def rebuild(path, robot=robots.JACKAL, **options):
    report = BagReport()
    return list(transitions(read(path, ranges=False), robot, report=report, **options)), report


def assert_equal(trajectory, drive, count=None, ends=True):
    """The trajectory is what the node saw and did; `ends`: it has the course's end, seen as its last decision was."""
    count = len(drive.thetas) if count is None else count
    assert len(trajectory) == count
    expected = np.array([*drive.observations, drive.observations[-1]][: count + 1])
    actions = [PaperForm(robots.JACKAL).action(theta) for theta in drive.thetas[:count]]
    if ends:
        expected[-1] = np.concatenate([expected[-2, :721], actions[-1]])
    np.testing.assert_array_equal(trajectory.scan, TransitionLayout().quantise(expected))
    np.testing.assert_allclose(trajectory.rest, expected[:, 720:], atol=1e-6)
    np.testing.assert_allclose(trajectory.action, actions, atol=1e-6)


def test_transitions_are_what_the_node_saw(tmp_path):
    drive = record(tmp_path / "a.bag")
    (trajectory,), report = rebuild(tmp_path / "a.bag")
    assert_equal(trajectory, drive)
    assert trajectory.terminated
    assert trajectory.info["success"]
    assert report.skipped == {}
    # R_f = -1 until the goal; R_p the metres towards it; R_c = -.05 / nearest range, at the end of the last scan
    nearest = [*(trajectory.scan[1:-1].min(axis=1) * TransitionLayout().step), drive.newest.min()]
    expected = np.array([-1, -1, -1, -1, 0]) + np.array([1, 1, 1, 1, 0.5]) - 0.05 / np.array(nearest)
    np.testing.assert_allclose(trajectory.reward, expected, atol=0.02)


class InTheMap(Drive):
    """Its goal is in the map, in which the odometry's frame is turned and moved."""

    FRAME = (1.0, 2.0, 0.5)

    def write_goal(self, t, goal):
        self.writer.transform(t - 0.1, "map", self.writer.robot.frames.odom, self.FRAME)
        self.writer.goal(t, (*transform_point(self.FRAME, *goal[:2]), goal[2]), "map")


def test_progress_counts_towards_a_goal_in_the_map(tmp_path):
    for name, kind in (("odom", Drive), ("map", InTheMap)):
        record(tmp_path / f"{name}.bag", kind)
    (expected,), _ = rebuild(tmp_path / "odom.bag")
    (found,), report = rebuild(tmp_path / "map.bag")
    assert report.skipped == {}
    np.testing.assert_allclose(found.reward, expected.reward, atol=1e-6)


def test_a_decision_was_made_at_the_pose_of_the_odometry_that_it_names(tmp_path):
    """At .5 m/s; all decisions but the first had odometry of .1 s before."""
    record(tmp_path / "a.bag", after=lambda drive, t, k: setattr(drive, "behind", 0.1))
    (trajectory,), _ = rebuild(tmp_path / "a.bag", reward=Reward(c_f=0.0, c_c=0.0))
    assert trajectory.reward[:2].tolist() == pytest.approx([0.95, 1.0])


def test_the_period_is_the_median_interval_in_whole_cycles():
    stamps = (0.0, 1.7, 3.71, 5.7, 7.71, 7.9)
    decisions = [SimpleNamespace(goal="g", stamp=int(stamp * SECOND)) for stamp in stamps]
    assert decision_period(SimpleNamespace(decisions=decisions, end=9 * SECOND)) == 2.0


def test_a_policy_in_the_dimensionless_form_has_seen_the_nearest_of_each_sector(tmp_path):
    layout = DimensionlessForm(robots.JACKAL, 2.0).layout
    drive = record(tmp_path / "a.bag", layout=layout)
    (trajectory,), report = rebuild(tmp_path / "a.bag")
    assert report.skipped == {}
    fine, coarse = np.array(drive.observations)[:, :720], trajectory.scan[:5] * TransitionLayout().step - 1.0
    assert (coarse <= fine + TransitionLayout().step).all()
    fine, coarse = (scans.reshape(5, 180, 4).min(axis=2) for scans in (fine, coarse))
    assert coarse.mean() == pytest.approx(fine.mean(), abs=0.03)
    np.testing.assert_allclose(trajectory.rest[:5], np.array(drive.observations)[:, 720:], atol=1e-6)
    record(tmp_path / "b.bag", layout=replace(layout, beams=100))
    _, report = rebuild(tmp_path / "b.bag")
    assert report.skipped == {"a decision was made with a scan of other beams than the robot's": 5 + 1}


def test_a_bag_of_fewer_scans_than_the_node_got_has_what_it_saw(tmp_path):
    drive = record(tmp_path / "a.bag", scan=lambda ranges, k: ranges if k % 2 or not k else None)
    (trajectory,), report = rebuild(tmp_path / "a.bag")
    assert_equal(trajectory, drive)
    assert report.skipped == {}


def test_a_bag_without_decisions_is_refused_in_one_line(tmp_path, capsys):
    record(tmp_path / "a.bag", node=False)
    assert bags_to_dataset.main([str(tmp_path / "a.bag"), "--out", str(tmp_path / "out")]) == 1
    line = "a.bag: no decisions on /applr/decision: record a drive of the applr node with record:=FILE; ./applr tune"
    printed, error = capsys.readouterr()
    assert line in printed
    assert error.count("\n") == 1


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
        (PREEMPTED, 9.98, None, 4, False),
        (None, 9.0, None, 4, False),
        (PREEMPTED, 9.0, 3.5, 4, True),  # a finish line before the goal, at 0.5 m/s after 7 s
    ],
)
def test_how_a_course_ends(tmp_path, status, seconds, finish, count, terminated):
    drive = record(tmp_path / "a.bag", status=status, seconds=seconds)
    (trajectory,), _ = rebuild(tmp_path / "a.bag", **({"finish": finish} if finish else {}))
    assert trajectory.terminated == terminated
    assert trajectory.info["success"] == (finish is not None)
    assert_equal(trajectory, drive, count, ends=terminated)


def test_the_status_says_how_a_course_ended_where_no_result_was_recorded(tmp_path):
    def end(drive, t, k):
        if k >= 450:
            drive.writer.status(t + 0.01, "g", running=False, ended=SUCCEEDED)

    record(tmp_path / "a.bag", status=None, after=end)
    (trajectory,), _ = rebuild(tmp_path / "a.bag")
    assert trajectory.terminated
    assert trajectory.info["success"]


@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_what_rosbags_convert_makes_of_a_bag_gives_the_same_transitions(tmp_path, storage):
    drive, command = record(tmp_path / "a.bag"), Path(sys.executable).with_name("rosbags-convert")
    for source, destination in (("a.bag", "ros2"), ("ros2", "back.bag")):
        words = ["--src", tmp_path / source, "--dst", tmp_path / destination, "--dst-storage", storage]
        subprocess.run([command, *words], check=True)
    assert bags_in([tmp_path / "ros2"]) == [tmp_path / "ros2"]  # one bag, whatever files it consists of
    converted = ["ros2", "back.bag"]
    if storage == "mcap":
        lone = tmp_path / "lone" / "deep"
        shutil.copytree(tmp_path / "ros2", lone)
        (lone / "metadata.yaml").unlink()
        (file,) = bags_in([tmp_path / "lone"])
        assert file == next(lone.glob("*.mcap"))
        converted.append(file)
    (expected,), _ = rebuild(tmp_path / "a.bag")
    assert_equal(expected, drive)
    for number, name in enumerate(converted):
        out = tmp_path / ("out%d" % number)
        assert bags_to_dataset.main([str(tmp_path / name), "--out", str(out)]) == 0
        ((_, stored),) = TrajectoryStore(out).trajectories()
        for array in ("scan", "rest", "action", "reward"):
            assert getattr(stored, array).tobytes() == getattr(expected, array).tobytes()


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
        ("goal", "the goal's position"),
        ("decision", "no decisions"),
    ):
        record(tmp_path / ("no_%s.bag" % missing), without=(missing,), node=missing != "decision")
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


@pytest.fixture
def hurried(monkeypatch):
    """Reading a bag may take 2 s and 1 GiB."""
    monkeypatch.setattr(bags, "LIMITS", {**bags.LIMITS, "CPU": 2, "AS": 2**30})


@pytest.mark.parametrize(
    "text", ["float64[300000000] data", "x_msgs/B[] a\n" + "=" * 80 + "\nMSG: x_msgs/B\n"], ids=["length", "empty"]
)
def test_a_definition_that_asks_for_endless_work_is_one_line(tmp_path, hurried, text):
    record(tmp_path / "whole.bag")
    with_definition(tmp_path / "a.bag", "/cmd_vel", "x_msgs/msg/A", text)
    with pytest.raises(BagError, match="a.bag: (reading it takes over|/cmd_vel is x_msgs/msg/A)") as refused:
        read(tmp_path / "a.bag")
    assert "\n" not in str(refused.value)


def test_endless_databases_and_settings_of_ros_2_bags_are_one_line(tmp_path, hurried):
    """A view can be endless; the settings of a topic are YAML in YAML."""
    record(tmp_path / "whole.bag")
    convert([tmp_path / "whole.bag"], tmp_path / "whole", "sqlite3", 9, None, "none", None, None, (), (), (), ())
    with closing(sqlite3.connect(next((tmp_path / "whole").glob("*.db3")))) as database, database:
        database.execute("ALTER TABLE schema RENAME TO before")
        database.execute(
            "CREATE VIEW schema AS WITH RECURSIVE r(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM r) "
            "SELECT MAX(x) AS schema_version FROM r"
        )
    shutil.copytree(tmp_path / "whole", tmp_path / "yaml")
    endless = "".join(f"a{k + 1}: &a{k + 1} {{<<: [*a{k}, *a{k}]}}\n" for k in range(60))
    (tmp_path / "yaml" / "metadata.yaml").write_text("a0: &a0 {x: 1}\n" + endless)
    for name in ("whole", "yaml"):
        with pytest.raises(BagError, match=f"{name}: (reading it takes over|damaged)") as refused:
            read(tmp_path / name)
        assert "\n" not in str(refused.value)


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


class Misses(Drive):
    """Its node leaves the third decision out."""

    def decide(self, t):
        if t != 14.0:
            super().decide(t)


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
        ({"kind": Misses}, [1, 2], "a decision's period is not that of the others"),
    ],
    ids=["gap", "moved", "person", "missed"],
)
def test_gaps_jumps_and_changes_cut_an_episode(tmp_path, changes, lengths, reason):
    record(tmp_path / "a.bag", **changes)
    found, report = rebuild(tmp_path / "a.bag")
    assert [len(t) for t in found] == lengths, report
    assert any(reason in text for text in report.skipped), report
    assert [t.terminated for t in found] == [False, True][: len(found)]


@pytest.mark.parametrize("value", [np.nan, 1.5, -1e30])
def test_an_observation_out_of_bounds_cuts_an_episode(tmp_path, value):
    class Other(Drive):
        def seen(self, layout):
            seen = super().seen(layout)
            seen[720] = value if self.number == 2 else seen[720]
            return seen

    record(tmp_path / "a.bag", Other)
    found, report = rebuild(tmp_path / "a.bag")
    assert report.skipped == {"the observation of a decision is not within [-1, 1]": 1}
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
    record(tmp_path / "a.bag", scan=scan)
    robot = replace(robots.JACKAL, laser=robots.JACKAL.laser.model_copy(update={"range_min": 0.4}))
    (trajectory,), report = rebuild(tmp_path / "a.bag", robot, reward=Reward(c_f=0.0, c_p=0.0, lowest=lowest))
    assert report.skipped == {}
    np.testing.assert_allclose(trajectory.reward, -0.05 / nearest, rtol=1e-5)


def test_the_goal_is_in_the_robots_odometry_frame(tmp_path):
    robot = replace(robots.JACKAL, frames=robots.JACKAL.frames.model_copy(update={"odom": "wheel_odom"}))
    with StackWriter(tmp_path / "a.bag", robot=robot) as writer:
        Drive(writer, seconds=0.0)
        topics = writer.topics.odometry, writer.topics.move_base + "/current_goal"
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
                if not outcome.over:  # no decision says what came of the last one, when the time was over
                    actions.append(form.action(outcome.theta))
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
        read(tmp_path / "nowhere.bag")
    assert bags_in([tmp_path]) == [Path(tmp_path / "a.bag")]
