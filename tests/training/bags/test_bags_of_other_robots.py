"""Bags of lasers and frames that differ from the Jackal's, and bags that are found by their names."""

from dataclasses import replace

import numpy as np
import pytest
from rosbags.convert import convert
from rosbags.highlevel import AnyReader
from test_bags import Drive, rebuild

from applr_ros1.robots import JACKAL
from training import bags_to_dataset
from training.bags.episodes import BagReport, trajectories
from training.bags.reader import find, read
from training.bags.writer import BagWriter
from training.env.reward import Reward


@pytest.mark.parametrize("lowest", [False, True])
def test_a_range_of_zero_is_no_obstacle(tmp_path, lowest):
    """Some lasers write 0 where nothing returned: the price of nearness is that of the smallest other range."""

    class Zeros(Drive):
        def step(self, t, k):
            self.without = ("scan",)
            super().step(t, k)
            self.ranges = np.full(720, 1.6, np.float32)
            self.ranges[::7] = 0.0
            if 210 < k < 390:  # nothing returns at all between the third and the fourth decision
                self.ranges[:] = 0.0 if k % 100 else self.ranges
            self.writer.scan(t, self.ranges)

    with BagWriter(tmp_path / "a.bag") as writer:
        Zeros(writer, node=False)
    (trajectory,), report = rebuild(tmp_path / "a.bag", reward=Reward(c_f=0.0, c_p=0.0, lowest=lowest))
    assert report.skipped == {}
    np.testing.assert_allclose(trajectory.reward, -0.05 / 1.6, rtol=1e-5)


def test_the_smallest_range_is_that_of_the_recordings_robot(tmp_path):
    class Near(Drive):
        def step(self, t, k):
            self.without = ("scan",)
            super().step(t, k)
            self.writer.scan(t, np.full(720, -np.inf, np.float32))  # too near to tell

    with BagWriter(tmp_path / "a.bag") as writer:
        Near(writer, node=False)
    robot = replace(JACKAL, laser=replace(JACKAL.laser, range_min=0.4))
    recording = read(tmp_path / "a.bag", robot=robot)
    (trajectory,) = trajectories(recording, Reward(c_f=0.0, c_p=0.0), report=BagReport())
    np.testing.assert_allclose(trajectory.reward, -0.05 / 0.4, rtol=1e-5)


def test_plan_and_goal_are_in_the_robots_odometry_frame(tmp_path):
    robot = replace(JACKAL, frames=replace(JACKAL.frames, odom="wheel_odom"))
    with BagWriter(tmp_path / "a.bag", robot=robot) as writer:
        drive = Drive(writer)
        topics = writer.topics
    with AnyReader([tmp_path / "a.bag"]) as reader:
        frames = {
            c.topic: reader.deserialize(raw, c.msgtype).header.frame_id
            for c, _, raw in reader.messages()
            if c.topic in (topics.odometry, topics.plan, topics.move_base + "/current_goal")
        }
    assert set(frames.values()) == {"wheel_odom"}
    assert len(frames) == 3
    (trajectory,), report = rebuild(tmp_path / "a.bag")
    assert (len(trajectory), report.skipped) == (len(drive.thetas), {})


def test_lone_mcap_files_are_found_in_folders_and_read(tmp_path):
    with BagWriter(tmp_path / "a.bag") as writer:
        drive = Drive(writer)
    convert([tmp_path / "a.bag"], tmp_path / "ros2", "mcap", 9, None, "none", None, None, (), (), (), ())
    assert find([tmp_path / "ros2"]) == [tmp_path / "ros2"]  # one bag, whatever files it consists of
    lone = tmp_path / "lone" / "deep"
    lone.mkdir(parents=True)
    (file,) = (tmp_path / "ros2").glob("*.mcap")
    file.rename(lone / "a.mcap")
    assert find([tmp_path / "lone"]) == [lone / "a.mcap"]
    assert bags_to_dataset.main([str(tmp_path / "lone"), "--out", str(tmp_path / "out")]) == 0
    (trajectory,), _ = rebuild(lone / "a.mcap")
    assert len(trajectory) == len(drive.thetas)
