"""Tests of APPLD: scripted demonstration, bag, contexts, a parameter set for each context, and a
policy file, which drives in this process and as the launch file's method.
"""

import copy
import json

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

import worlds
from applr_ros1.drives.drive import Commands, Drive, Scans
from applr_ros1.planner.parameters.settings import send
from applr_ros1.policy import actor, methods
from applr_ros1.policy.parameter_space import SPACE
from applr_ros1.robots import JACKAL, load
from tests.support.refusals import refused
from training.appld import __main__ as appld
from training.appld import classifier as appld_classifier
from training.appld import demonstration
from training.appld import fit as appld_fit
from training.appld import scripted_driver as demonstrator
from training.appld import segmentation as contexts
from training.appld.demonstrate import main as demonstrate
from training.bags.topics import TopicNames
from worlds.world import clearance


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """Scripted demonstration in a generated world, about 9 s long."""
    path = tmp_path_factory.mktemp("appld") / "demonstration.bag"
    assert (
        demonstrate(
            [str(path), "--world", "generated:3", "--simulator", "kinematic", "--seed", "1"]
        )
        == 0
    )
    return path


def test_another_robot_is_demonstrated_at_its_size_and_speed(tmp_path):
    robot = load("turtlebot3_waffle_pi")
    path = tmp_path / "waffle.bag"
    words = [str(path), "--world", "generated:3", "--simulator", "kinematic", "--robot", robot.name]
    assert demonstrate(words) == 0
    d = demonstration.read_demonstration(path, TopicNames.of(robot), robot)
    assert d.source["robot"] == robot.name
    assert 0.2 < d.commands.twist[:, 0].max() <= robot.base.max_speed
    assert len(d.scans.ranges[0]) == robot.laser.beams
    course = worlds.scaled(worlds.load("generated:3"), robot.world_scale).course
    assert d.sent[-1].pose[:2] == pytest.approx(np.subtract(course.goal[:2], course.start[:2]))
    with AnyReader([path]) as reader:
        counts = {c.topic: c.msgcount for c in reader.connections}
    scans = counts["/" + robot.topics.scan] / counts["/" + robot.topics.odometry]
    # The laser is slower than the control cycle.
    assert scans == pytest.approx(robot.laser.rate * 0.05, rel=0.05)


def test_bag_is_read_as_it_was_driven(bag):
    d = demonstration.read_demonstration(bag)
    assert d.source["demonstrator"].startswith("scripted")
    assert d.source["world"] == "generated:3"
    assert len(d.odometry) == len(d.commands) == len(d.scans)
    assert len(d.scans.ranges[0]) == 720
    assert np.allclose(np.diff(d.scans.time), 0.05)
    assert demonstration.is_driving(d).all()
    # The base follows a command in the cycles after it.
    assert np.abs(d.odometry.twist[5:, 0] - d.commands.twist[3:-2, 0]).mean() < 0.05
    world = worlds.load("generated:3")
    assert d.sent[-1].pose[:2] == pytest.approx(
        (world.course.goal[0] - world.course.start[0], world.course.goal[1] - world.course.start[1])
    )


@pytest.mark.parametrize("spec", ["generated:290", "physical_course"])
def test_the_demonstrators_route_keeps_away_from_obstacles(spec):
    world = worlds.load(spec)
    points = demonstrator.route(world)
    assert clearance(world, points).min() > 0.3
    assert np.hypot(*np.diff(points, axis=0).T).max() < 0.08
    assert np.allclose(points[0], world.course.start[:2])


@pytest.mark.parametrize(
    ("speeds", "of_two"), [((1.0, 0.3, 1.0), [0, 1, 0]), ((1.0, 0.2, 0.5), [0, 1, 1])]
)
def test_changepoints_are_found_within_three_instants(speeds, of_two):
    """Three segments between walls: the slower the robot, the nearer the walls. Contexts have the
    order of driving.
    """
    n = 400
    speed = np.repeat(speeds, (150, 110, 140))
    rng = np.random.default_rng(0)
    ranges = 3.0 * speed[:, None] - 0.4 + rng.normal(0, 0.01, (n, 720))
    command = np.column_stack([speed, rng.normal(0, 0.02, n)])
    time = np.arange(n) * 0.05
    laser = JACKAL.laser
    fan = np.tile((laser.first_angle, laser.increment, laser.range_min, laser.range_max), (n, 1))
    d = Drive(
        scans=Scans(time, time, fan, list(ranges.astype(np.float32))),
        commands=Commands(time, command),
    )
    three = contexts.find([d], JACKAL)
    assert [
        (abs(s.first - a) <= 3, abs(s.last - b) <= 3)
        for s, a, b in zip(three.segments, (0, 150, 260), (150, 260, 400))
    ] == [(True, True)] * 3
    assert [s.context for s in contexts.find([d], JACKAL, most=2).segments] == of_two
    assert len(contexts.find([d], JACKAL, most=0).names) == 3


def test_search_finds_the_speed_of_a_demonstration(bag):
    """Commands that the planner gave with other parameters are matched, exactly if these parameters
    are used.
    """
    d = demonstration.read_demonstration(bag)
    spans = [contexts.Segment(0, 30, 60, 0), contexts.Segment(0, 60, len(d.commands), 0)]
    stretch, longest = appld_fit.stretches(d, JACKAL, spans)
    assert longest.last - longest.first == 100  # five seconds
    theta = SPACE.from_dict({"max_vel_x": 1.0, "gdist_scale": 1.4})
    replayed = copy.deepcopy(stretch.planner)
    send(SPACE.settings(theta), replayed)
    d.commands.twist[30:60] = [appld_fit.step(replayed, d, JACKAL, i) for i in range(30, 60)]
    assert appld_fit.loss([stretch], theta)[0] == 0.0
    fitted = appld_fit.fit([stretch], 30, seed=0)
    assert fitted.loss < 0.5 * fitted.loss_theta0
    assert fitted.replays <= 41
    assert fitted.theta[0] > 0.7


def test_the_classifier_distinguishes_scans_and_mirrored_scans(tmp_path, monkeypatch):
    monkeypatch.setattr(appld_classifier, "STEPS", 60)
    rng = np.random.default_rng(0)
    labels = np.repeat([0, 1], 200)
    ranges = np.where(labels[:, None] == 1, 0.5, 2.0) * np.ones((400, 720), np.float32)
    ranges[:, 500:] = 0.4  # A wall on one side is the same in both contexts.
    scans = appld_classifier.inputs(ranges + rng.normal(0, 0.05, ranges.shape))
    weights, result = appld_classifier.train(scans, labels, 2)
    assert result["accuracy"] > 0.98
    assert result["held_out"] > 0.98
    path = tmp_path / "contexts.safetensors"
    actor.save_contexts(path, {"a": SPACE.chosen.theta0, "b": SPACE.chosen.high}, weights)
    net = actor.load(path)
    assert [net.context(scan[::-1]) for scan in scans[[0, 399]]] == [0, 1]


def test_from_bag_to_a_file_that_drives(bag, tmp_path, monkeypatch):
    monkeypatch.setattr(appld_fit, "LONGEST", 10)
    monkeypatch.setattr(appld_classifier, "STEPS", 30)
    out = tmp_path / "mine.safetensors"
    short = ["--evaluations", "4", "--contexts", "2", "--penalty", "0.5"]
    assert appld.main([str(bag), "--out", str(out), *short]) == 0
    log = json.loads((tmp_path / "mine_log.json").read_text())
    assert log["demonstrations"][0]["demonstrator"].startswith("scripted")
    assert all(c["loss"] <= c["loss_theta0"] for c in log["contexts"])
    assert str(tmp_path) not in (tmp_path / "mine_log.json").read_text()
    method = methods.make(str(out))
    d = demonstration.read_demonstration(bag)
    scans = appld_classifier.inputs(demonstration.policy_scans(d, JACKAL)[:1])
    obs = np.concatenate([scans[0], np.zeros(9, np.float32)])
    theta = method.sets[method.context(obs)]
    assert any(np.allclose(theta, list(c["parameters"].values())) for c in log["contexts"])
    assert method.describe()["file"] == "mine.safetensors"


def test_the_shipped_file_drives():
    """The metadata of the file name the scripted demonstrator."""
    path = methods.shipped("appld.safetensors", JACKAL)
    loaded = actor.load(path)
    assert 2 <= len(loaded.names) <= 8
    assert "scripted" in loaded.metadata["training"]["demonstrations"][0]["demonstrator"]
    refused(lambda: methods.make(path, load("husky")), "for the robot jackal: this robot is husky")
    assert np.array_equal(methods.make("appld").sets, loaded.sets)
