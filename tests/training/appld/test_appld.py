"""Tests of APPLD: scripted demonstration, bag, contexts, a parameter set for each context, and a
policy file, which drives in this process and as the launch file's method.
"""

import copy
import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

import worlds
from applr_ros1.common.paths import step_lengths
from applr_ros1.drives.columns import TopicNames
from applr_ros1.drives.drive import Commands, Drive, Motion, Scans
from applr_ros1.policy import actor, methods
from applr_ros1.policy.actor import forward
from applr_ros1.policy.encoding import PaperEncoding
from applr_ros1.policy.layout import Layout
from applr_ros1.policy.observation import layout_of, observe
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
from worlds.world import clearance


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """Scripted demonstration in a generated world, about 9 s long."""
    path = tmp_path_factory.mktemp("appld") / "demonstration.bag"
    options = ["--world", "generated:3", "--simulator", "kinematic", "--seed", "1"]
    assert demonstrate([str(path), *options]) == 0
    return path


def from_start_to_goal(course):
    """Return the way (x, y) [m] from the start of a course straight to its goal."""
    start_x, start_y, _ = course.start
    goal_x, goal_y, _ = course.goal
    return goal_x - start_x, goal_y - start_y


def test_another_robot_is_demonstrated_at_its_size_and_speed(tmp_path):
    robot = load("turtlebot3_waffle_pi")
    path = tmp_path / "waffle.bag"
    options = ["--world", "generated:3", "--simulator", "kinematic", "--robot", robot.name]
    assert demonstrate([str(path), *options]) == 0

    drive = demonstration.read_demonstration(path, TopicNames.of(robot), robot)

    assert drive.source["robot"] == robot.name
    highest_speed = drive.commands.twist[:, 0].max()
    assert 0.2 < highest_speed <= robot.base.max_speed
    assert len(drive.scans.ranges[0]) == robot.laser.beams
    world = worlds.scaled(worlds.load("generated:3"), robot.world_scale)
    assert drive.goal_pose[:2] == pytest.approx(from_start_to_goal(world.course))

    # The laser is slower than the control cycle of 0.05 s, in which the odometry comes.
    message_counts = {}
    with AnyReader([path]) as reader:
        for connection in reader.connections:
            message_counts[connection.topic] = connection.msgcount
    scan_count = message_counts["/" + robot.topics.scan]
    cycle_count = message_counts["/" + robot.topics.odometry]
    assert scan_count / cycle_count == pytest.approx(robot.laser.rate * 0.05, rel=0.05)


def test_bag_is_read_as_it_was_driven(bag):
    drive = demonstration.read_demonstration(bag)
    assert drive.source["demonstrator"].startswith("scripted")
    assert drive.source["world"] == "generated:3"
    assert len(drive.odometry) == len(drive.commands) == len(drive.scans)
    assert len(drive.scans.ranges[0]) == 720
    assert np.allclose(np.diff(drive.scans.time), 0.05)
    assert demonstration.is_driving(drive).all()

    # The base follows a command two cycles after it.
    measured_speed = drive.odometry.twist[5:, 0]
    commanded_speed = drive.commands.twist[3:-2, 0]
    assert np.abs(measured_speed - commanded_speed).mean() < 0.05

    course = worlds.load("generated:3").course
    assert drive.goal_pose[:2] == pytest.approx(from_start_to_goal(course))


@pytest.mark.parametrize("spec", ["generated:290", "physical_course"])
def test_the_demonstrators_route_keeps_away_from_obstacles(spec):
    world = worlds.load(spec)
    points = demonstrator.route(world)
    assert clearance(world, points).min() > 0.3
    assert step_lengths(points).max() < 0.08
    assert np.allclose(points[0], world.course.start[:2])

    open_floor = replace(world, cylinders=np.empty((0, 3)), boxes=np.empty((0, 5)))
    assert len(demonstrator.route(open_floor)) > 10


def test_scans_in_the_lasers_own_time_are_no_demonstration():
    """Without their clock being looked at, too little driving would be blamed."""
    times = np.arange(200) / 20.0
    twists = np.tile([0.5, 0.0], (200, 1))
    scans = Scans(times, times + 60.0, np.tile([-1.0, 0.1, 0.1, 5.0], (200, 1)), [np.ones(3)] * 200)
    drive = Drive(
        odometry=Motion(times, times, np.zeros((200, 3)), twists),
        scans=scans,
        commands=Commands(times, twists),
    )
    refused(
        lambda: demonstration.instants(drive),
        "scans are stamped 60.0 s after the odometry: the clocks differ; "
        "set the driver of the laser to the computer's time",
    )
    in_one_time = replace(drive, scans=replace(scans, stamp=times))
    assert len(demonstration.instants(in_one_time).scans) > 100


@pytest.mark.parametrize("nothing", [np.nan, 0.0])
def test_beams_without_a_measurement_are_filled_as_for_a_policy(nothing):
    """A network that has learnt another input than it gets would choose another context."""
    layout = layout_of(JACKAL)
    scan = np.linspace(0.2, 3.0, layout.beams).astype(np.float32)
    scan[100:140] = np.nan
    scan[-1] = np.inf
    observation = observe(scan, 0.0, SPACE.theta0)
    (inputs,) = appld_classifier.inputs(scan[np.newaxis])
    np.testing.assert_array_equal(inputs, observation[: layout.beams])

    # An instant at which the laser measures nothing is left out, as a decision is.
    times = np.arange(200) / 20.0
    fans = np.tile([-2.356, 4.712 / 719, 0.1, 30.0], (200, 1))
    ranges = [np.ones(720, np.float32)] * 200
    ranges[50] = np.full(720, nothing, np.float32)
    drive = Drive(
        odometry=Motion(times, times, np.zeros((200, 3)), np.tile([0.5, 0.0], (200, 1))),
        scans=Scans(times, times, fans, ranges),
        commands=Commands(times, np.tile([0.5, 0.0], (200, 1))),
    )
    demonstrated = demonstration.instants(drive)
    assert len(demonstrated.scans) == 199
    features = contexts.features(demonstrated, JACKAL)
    np.testing.assert_allclose(features[:, 2:], 1.0)


def between_walls(speeds):
    """Return a demonstration with these speeds (n,) [m/s] between walls: the slower the robot, the
    nearer the walls.
    """
    count = len(speeds)
    rng = np.random.default_rng(0)
    range_noise = rng.normal(0, 0.01, (count, 720))
    ranges = 3.0 * speeds[:, None] - 0.4 + range_noise
    yaw_rate = rng.normal(0, 0.02, count)
    time = np.arange(count) * 0.05
    laser = JACKAL.laser
    fan = (
        laser.first_angle,
        laser.increment,
        laser.range_min,
        laser.range_max,
    )
    scans = Scans(
        time,
        time,
        np.tile(fan, (count, 1)),
        list(ranges.astype(np.float32)),
    )
    commands = Commands(time, np.column_stack([speeds, yaw_rate]))
    motion = Motion(time, time, np.zeros((count, 3)), commands.twist)
    return demonstration.Demonstration(
        "", scans, motion, commands, goal_pose=(0.0, 0.0, 0.0), source={}
    )


@pytest.mark.parametrize(
    ("speeds", "of_two"), [((1.0, 0.3, 1.0), [0, 1, 0]), ((1.0, 0.2, 0.5), [0, 1, 1])]
)
def test_changepoints_are_found_within_three_instants(speeds, of_two, monkeypatch):
    """Contexts have the order of driving."""
    # Given: a drive with changes after 150 and 260 of 400 instants
    drive = between_walls(np.repeat(speeds, (150, 110, 140)))

    # When: its contexts are sought
    segments = contexts.find([drive], JACKAL).segments

    # Then: the segments begin and end at the changes
    assert len(segments) == 3
    for segment, first, last in zip(segments, (0, 150, 260), (150, 260, 400)):
        assert abs(segment.first - first) <= 3
        assert abs(segment.last - last) <= 3

    # Of two contexts, the segments that are most alike have one.
    monkeypatch.setattr(contexts, "MOST_CONTEXTS", 2)
    in_two = contexts.find([drive], JACKAL)
    assert [segment.context for segment in in_two.segments] == of_two


def test_a_demonstration_too_short_for_two_segments_is_one():
    # A segment lasts for at least 1.5 s, which are 30 instants.
    drive = between_walls(np.repeat([1.0, 0.3], (30, 29)))
    (segment,) = contexts.find([drive], JACKAL).segments
    assert (segment.first, segment.last) == (0, 59)


@pytest.mark.slow
def test_search_finds_the_speed_of_a_demonstration(bag, monkeypatch):
    """Commands that the planner gave with other parameters are matched, exactly if these parameters
    are used.
    """
    # Given: a stretch of the drive in which the commands are the planner's with other parameters
    drive = demonstration.read_demonstration(bag)
    spans = [
        contexts.Segment(0, 30, 60, 0),
        contexts.Segment(0, 60, len(drive.commands), 0),
    ]
    stretch, longest = appld_fit.stretches(drive, JACKAL, spans)
    assert longest.last - longest.first == 100  # five seconds
    theta = SPACE.from_dict({"max_vel_x": 1.0, "gdist_scale": 1.4})
    planner = copy.deepcopy(stretch.planner)
    planner.put_in_force(SPACE.settings(theta))
    for index in range(30, 60):
        drive.commands.twist[index] = appld_fit.step(planner, drive, JACKAL, index)

    # Then: these parameters have no loss, and the search comes near them
    assert appld_fit.loss([stretch], theta) == 0.0
    monkeypatch.setattr(appld_fit, "EVALUATIONS", 30)
    fitted = appld_fit.fit([stretch], seed=0)
    assert fitted.loss < 0.5 * fitted.loss_theta0
    assert fitted.replays <= 41
    assert fitted.theta[0] > 0.7


def test_a_squared_error_of_the_yaw_rate_weighs_a_quarter_of_one_of_the_speed(monkeypatch):
    monkeypatch.setattr(appld_fit, "replay", lambda errors, theta: np.array(errors))
    # Errors of two stretches [m/s, rad/s], whose mean squares are 1 and 4
    fast_and_left = [(1.0, 2.0), (-1.0, 2.0)]
    slow_and_right = [(-1.0, -2.0)]
    loss = appld_fit.loss([fast_and_left, slow_and_right], SPACE.theta0)
    assert loss == 1.0 + 0.25 * 4.0


@pytest.mark.parametrize(
    ("last", "counted"),
    [
        (20, [15, 16, 18, 19]),  # Five instants are ignored.
        (16, [13, 14, 15]),  # Half of a short stretch is ignored.
    ],
)
def test_errors_count_after_five_instants_where_the_demonstrator_drives(monkeypatch, last, counted):
    # Given: a demonstration at 0.5 m/s that stands at instant 17, and a planner that commands the
    # number of the instant
    twists = np.tile([0.5, 0.0], (30, 1))
    twists[17] = 0.0
    commands = Commands(np.arange(30) * 0.05, twists)
    drive = demonstration.Demonstration(
        "", None, None, commands, goal_pose=(0.0, 0.0, 0.0), source={}
    )
    planner = SimpleNamespace(put_in_force=lambda settings: None)
    stretch = appld_fit.DemonstrationStretch(drive, JACKAL, 10, last, planner)
    monkeypatch.setattr(appld_fit, "step", lambda planner, drive, robot, i: (float(i), 0.0))

    errors = appld_fit.replay(stretch, SPACE.theta0)

    assert (errors[:, 0] + 0.5).tolist() == counted


def test_parameters_that_change_no_command_stay_at_their_defaults(monkeypatch):
    """Loss of a demonstration that depends on the maximum speed alone"""
    encoding = PaperEncoding(JACKAL)
    default_action = encoding.action(encoding.space.theta0)
    fastest_action = 0.5

    def loss(parts, theta):
        action = encoding.action(theta)
        return (action[0] - fastest_action) ** 2

    monkeypatch.setattr(appld_fit, "loss", loss)
    stretch = appld_fit.DemonstrationStretch(None, JACKAL, first=0, last=1, planner=None)

    monkeypatch.setattr(appld_fit, "EVALUATIONS", 1500)
    fitted = appld_fit.fit([stretch], seed=0)

    action = encoding.action(fitted.theta)
    assert action[0] == pytest.approx(fastest_action, abs=0.02)
    np.testing.assert_allclose(action[1:], default_action[1:], atol=0.1)


def test_the_classifier_distinguishes_scans_and_mirrored_scans(tmp_path, monkeypatch):
    # Given: 200 scans in wide and 200 in narrow space
    monkeypatch.setattr(appld_classifier, "STEPS", 60)
    rng = np.random.default_rng(0)
    labels = np.repeat([0, 1], 200)
    ranges = np.full((400, 720), 2.0)
    ranges[labels == 1] = 0.5
    # A wall on one side is the same in both contexts.
    ranges[:, 500:] = 0.4
    noise = rng.normal(0, 0.05, ranges.shape)
    scans = appld_classifier.inputs(ranges + noise)

    # When: a classifier is trained
    weights, scores = appld_classifier.train(scans, labels, 2)

    # Then: it tells them apart
    assert scores["accuracy"] > 0.98
    assert scores["held_out"] > 0.98

    # The stored one also does so in mirror images.
    path = tmp_path / "contexts.safetensors"
    sets = {
        "a": SPACE.chosen.theta0,
        "b": SPACE.chosen.high,
    }
    actor.save_contexts(path, sets, weights)
    classifier = actor.load(path)
    mirrored_wide = scans[0][::-1]
    mirrored_narrow = scans[399][::-1]
    assert classifier.context(mirrored_wide) == 0
    assert classifier.context(mirrored_narrow) == 1


def test_a_rare_context_counts_as_much_as_a_frequent_one(monkeypatch):
    # Given: scans that do not show their context, of which one in ten is of the second one
    monkeypatch.setattr(appld_classifier, "STEPS", 100)
    layout = Layout(beams=10)
    scans = np.zeros((100, layout.beams), np.float32)
    labels = np.repeat([0, 1], [90, 10])

    weights, scores = appld_classifier.train(scans, labels, 2, layout=layout)

    # Then: both have nearly the same score. Without a balance, they would differ by more than 1.
    frequent_score, rare_score = forward(actor.layers_of(weights), scans[0])
    assert abs(frequent_score - rare_score) < 0.5
    assert scores["held_out"] is None, "100 instants have no fifth block"


def test_every_fifth_block_of_forty_instants_is_held_out(monkeypatch):
    # Given: a classifier whose weights are the number of its scans
    monkeypatch.setattr(appld_classifier, "fit", lambda scans, *others: len(scans))
    monkeypatch.setattr(
        appld_classifier, "accuracy", lambda weights, scans, labels: (weights, scans.tolist())
    )
    instants = np.arange(410)
    labels = instants % 2

    _, scores = appld_classifier.train(instants, labels, 2)

    held_out = [*range(160, 200), *range(360, 400)]
    assert scores["held_out"] == (410 - 80, held_out)
    assert scores["accuracy"] == (410, instants.tolist())
    assert scores["instants"] == 410


def test_contexts_are_named_by_what_distinguishes_them_from_the_usual_one():
    means = np.array(
        [  # speed, turning, ahead, near side, far side
            (1.2, 0.1, 4.0, 1.5, 2.0),
            (0.8, 0.3, 2.0, 1.0, 2.0),
            (0.4, 0.6, 1.0, 0.5, 2.0),
        ]
    )
    assert contexts.names_of(means) == [
        "1 open, wide, fast",
        "2 close ahead, wide, slow",
        "3 close ahead, narrow, slow, turning",
    ]


@pytest.mark.slow
def test_from_bag_to_a_file_that_drives(bag, tmp_path, monkeypatch):
    monkeypatch.setattr(appld_fit, "LONGEST", 10)
    monkeypatch.setattr(appld_classifier, "STEPS", 30)
    policy_file = tmp_path / "mine.safetensors"
    monkeypatch.setattr(appld_fit, "EVALUATIONS", 4)
    monkeypatch.setattr(contexts, "MOST_CONTEXTS", 2)
    monkeypatch.setattr(contexts, "PENALTY", 0.5)
    assert appld.main([str(bag), "--out", str(policy_file)]) == 0

    # The log says where the file comes from, and names no folder of this machine.
    log_text = (tmp_path / "mine_log.json").read_text()
    log = json.loads(log_text)
    assert log["demonstrations"][0]["demonstrator"].startswith("scripted")
    for context in log["contexts"]:
        assert context["loss"] <= context["loss_theta0"]
    assert str(tmp_path) not in log_text

    # The method drives with one of the fitted sets.
    method = methods.make(str(policy_file))
    drive = demonstration.read_demonstration(bag)
    first_ranges = demonstration.policy_scans(drive, JACKAL)[:1]
    (scan,) = appld_classifier.inputs(first_ranges)
    # A classifier of contexts does not read the numbers after the scan.
    observation = np.concatenate([scan, np.zeros(9, np.float32)])
    theta = method.sets[method.context(observation)]
    fitted_sets = []
    for context in log["contexts"]:
        fitted_sets.append(list(context["parameters"].values()))
    is_fitted_set = np.isclose(fitted_sets, theta).all(axis=1)
    assert is_fitted_set.any()
    assert method.describe()["file"] == "mine.safetensors"


def test_the_shipped_file_drives():
    """The metadata of the file name the scripted demonstrator."""
    path = methods.shipped("appld.safetensors", JACKAL)
    loaded = actor.load(path)
    assert 2 <= len(loaded.names) <= 8
    (first_demonstration, *_) = loaded.metadata["training"]["demonstrations"]
    assert "scripted" in first_demonstration["demonstrator"]
    refused(
        lambda: methods.make(path, load("husky")),
        "for the robot jackal: this robot is husky",
    )
    assert np.array_equal(methods.make("appld").sets, loaded.sets)
