"""What a bag says: its course, the robot, how far to believe the rest, and what is wrong with it. Own small drives."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import sim_bridge
from applr_ros1.common.angles import compose, inverse
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.robots import measured
from applr_ros1.robots.folder import load
from tests.support.recording import RecordingEpisode, StackWriter
from training.bags import courses
from training.bags.bag import BagError
from training.bags.drive import Pace
from training.bags.topics import TopicNames
from training.env.episode import counting_cells
from training.tune import bag
from worlds import Course, World
from worlds.seen import Scan, seen
from worlds.world import clearance

JACKAL = load("jackal")
DELAY, NOISE = 0.15, 0.01  # s, m; the simulated robot's, which no file says
START = (1.0, 2.0, 0.5)
WALLS = [(x, y, 0.1) for x in np.arange(-1.0, 7.0, 0.15) for y in (0.4, 5.0)] + [(3.0, 2.6, 0.15), (4.2, 3.8, 0.15)]
WORLD = World(
    "lane",
    np.array(WALLS),
    np.empty((0, 5)),
    Course(START, (5.5, 3.4, 0.0), None, 0.4, np.array([START[:2], (5.5, 3.4)])),
)


class Tape:
    """Takes what a StackWriter takes, as a list of (method, time, ...) that can be changed and written."""

    topics, robot = TopicNames.of(JACKAL), JACKAL

    def __init__(self):
        self.events = []

    def __getattr__(self, name):
        return lambda *args, **more: self.events.append((name, *args, more))


@pytest.fixture(scope="module")
def driven():
    """(events, outcome): 5 m through a lane by a Jackal that is late, whose scanner is noisy, and that stands then."""
    robot = replace(
        JACKAL,
        laser=JACKAL.laser.model_copy(update={"noise": NOISE}),
        simulation=JACKAL.simulation.model_copy(update={"command_delay": DELAY}),
    )
    simulator, tape = sim_bridge.make("kinematic", robot=robot), Tape()
    planner = MoveBase(counting_cells(JACKAL.parameters()), planner="cpp-like")
    episode = RecordingEpisode(simulator, planner, tape, period=2.0)
    send = simulator.command

    def command(v, w):
        tape.command(episode._now, v, w)
        send(v, w)

    simulator.command = command
    outcome = episode.reset(WORLD, 1)
    while not outcome.over:
        outcome = episode.decide(episode.space.theta0)
    assert outcome.success
    for _ in range(40):
        command(0.0, 0.0)
        state = simulator.advance(0.05)
        tape.odometry(episode._now, state.odom_pose, state.odom_twist)
        tape.scan(episode._now, simulator.scan())
    return [event for event in tape.events if event[0] != "decision"], outcome


def written(path, events, topics=Tape.topics, chunk=1 << 20):
    with StackWriter(path, topics) as writer:
        writer._writer.chunk_threshold = chunk
        for name, *args, more in sorted(events, key=lambda event: event[1]):
            getattr(writer, name)(*args, **more)
    return path


@pytest.fixture(scope="module")
def recorded(driven, tmp_path_factory):
    return courses.read([written(tmp_path_factory.mktemp("bags") / "lane.bag", driven[0])], JACKAL)


def in_world(points):
    """Points (n, 2) of the odometry's frame, which lies parallel to the world's, in the world's."""
    return points + START[:2]


def test_the_world_is_what_stood_there_and_the_course_what_was_driven(recorded, driven):
    free, dark = recorded.courses[0].worlds
    surfaces = in_world(free.cylinders[:, :2])
    depth = -clearance(WORLD, surfaces)  # a surface is that of cylinders whose middles lie .04 m behind it
    assert -0.03 < depth.min() < 0.02 < np.median(depth) < depth.max() < 0.08
    away = clearance(WORLD, in_world(recorded.courses[0].poses[:, :2]))
    narrower = away - clearance(free, recorded.courses[0].poses[:, :2])
    assert abs(narrower[away < 0.8].mean()) < 0.006, "passages are as wide as they were"
    seen_posts = np.hypot(*(surfaces[:, None] - WORLD.cylinders[-2:, :2]).transpose(2, 0, 1)).min(axis=0)
    assert (seen_posts < 0.15).all()
    away = in_world(dark.cylinders[len(free.cylinders) :, :2]) - START[:2]
    behind = away[np.hypot(*away.T) < 1.5] @ (-np.cos(START[2]), -np.sin(START[2]))
    assert len(behind) > 5
    assert behind.min() > 0.3  # the laser looks over 270 degrees
    course = free.course
    np.testing.assert_allclose(in_world(np.array(course.start[:2])), START[:2], atol=0.03)
    np.testing.assert_allclose(in_world(np.array(course.goal[:2])), WORLD.course.goal[:2], atol=0.01)
    assert course.start[2] == pytest.approx(START[2], abs=0.03)
    assert clearance(free, course.path).min() > 0.15


def test_the_check_drives_the_recorded_parameters_in_the_recorded_time(recorded, driven):
    (course,) = recorded.courses
    assert course.pace.time_s == pytest.approx(driven[1].time_s, abs=0.8)
    check = bag.check(recorded, drives=1)
    assert check.agrees, check
    assert "believe differences of more than" in check.sentence
    fastest = np.array([parameter.name == "max_vel_x" for parameter in JACKAL.space])
    slow = course._replace(theta=np.where(fastest, 0.25, course.theta))
    check = bag.check(replace(recorded, courses=[slow]), drives=1)
    assert not check.agrees
    assert "s where the recorded ones take" in check.sentence
    assert "% (at most 20 % are believed): what is found may not hold for this robot" in check.sentence
    assert " arrive" not in check.sentence


@pytest.mark.parametrize(
    ("drives", "words"),
    [
        ([(30.0, 1), (30.0, 1), (60.0, 0), (60.0, 0)], "on lane 2 of 4 simulated drives arrive, and simulated drives"),
        ([(21.0, 1), (20.0, 0), (20.0, 0), (19.0, 0)], "on lane 1 of 4 simulated drives arrive: what is found may"),
        (
            [(30.0, 1)] * 4,
            "take 50 s where the recorded ones take 40 s, +25 % (at most 20 % are believed), most on lane:",
        ),
        (
            [(9.0, 1)] * 4,
            "take 29 s where the recorded ones take 40 s, -28 % (at most 20 % are believed), most on lane: ",
        ),
        ([(25.0, 1)] * 4, ""),
        ([(70.0, 1), (70.0, 1), (70.0, 1), (10.0, 0)], ""),
    ],
)
def test_a_refusal_names_time_or_arrivals_with_the_course_and_the_numbers(recorded, monkeypatch, drives, words):
    lane = recorded.courses[0]._replace(name="lane", pace=Pace(20.0, 5.0, 0.5, 0.0))
    hall = lane._replace(name="hall")
    taken = {"lane": drives, "hall": [(20.0, 1)] * 4}
    paces = {name: [Pace(time, 5.0, 0.5, 0.0, bool(there)) for time, there in of] for name, of in taken.items()}
    monkeypatch.setattr(bag, "MANY", 0)
    monkeypatch.setattr(bag, "simulated", lambda robot, course, world, seed: paces[course.name].pop(0))
    check = bag.check(replace(recorded, courses=[lane, hall]), drives=2)
    assert check.agrees == (not words)
    assert words in check.sentence
    assert "hall" not in check.sentence


def test_each_drive_of_the_check_draws_its_own_noise_half_of_them_with_the_unseen_as_wall(recorded, monkeypatch):
    (course,), driven = recorded.courses, []
    monkeypatch.setattr(bag, "simulated", lambda *how: driven.append((how[3], how[2].name)) or course.pace)
    assert bag.check(recorded, drives=2, seed=5).agrees
    free, dark = (world.name for world in course.worlds)
    assert driven == [(5, free), (6, dark), (7, free), (8, dark)]


def test_the_robot_is_measured(recorded):
    fields = recorded.fields
    assert fields["simulation", "command_delay"].value == pytest.approx(DELAY, abs=0.03)
    assert fields["odometry", "lag"].value == pytest.approx(0.03, abs=0.021)
    assert fields["odometry", "lag"].spread >= measured.STEP, "it is no better known than the grid that was tried"
    assert fields["laser", "noise"].value == pytest.approx(NOISE, rel=0.15)
    assert recorded.robot.laser.noise == fields["laser", "noise"].value
    assert ("laser", "no_return") not in fields
    assert ("base", "max_speed") not in fields  # it was never told to drive faster than it can


def test_copies_are_other_courses_of_the_same_room(recorded):
    free = recorded.worlds[0]
    copies = recorded.worlds[2:]
    assert len({world.name for world in recorded.worlds}) == len(recorded.worlds) == 8
    assert len({len(world.cylinders) for world in copies}) == 2  # with the unseen as free and as wall
    back = inverse(free.course.start)
    for copy in copies[::2]:
        assert clearance(copy, copy.course.path).min() > clearance(free, free.course.path).min() - 0.06
        goals = [np.array(compose(inverse(w.course.start), w.course.goal)[:2]) for w in (free, copy)]
        assert 0.005 < abs(np.hypot(*goals[0]) - np.hypot(*goals[1])) + abs(abs(goals[0][1]) - abs(goals[1][1])) < 0.4
    sides = {np.sign(compose(inverse(c.course.start), c.course.goal)[1]) for c in copies}
    assert compose(back, free.course.goal)[1] < 0.0
    assert sides == {-1.0, 1.0}  # some are mirrored
    assert np.ptp([c.course.start[2] for c in copies]) > 1.0


def without(*names):
    return lambda events: [event for event in events if event[0] not in names]


def standing(events):
    return [event for event in events if event[1] > max(event[1] for event in events) - 1.5]


def changed(events, kind, change):
    """Events in which the first argument of one kind is change(argument, time)."""
    return [
        (name, at, change(args[0], at), *args[1:]) if name == kind else (name, at, *args) for name, at, *args in events
    ]


def jump(events):
    """The odometry is set elsewhere in the last second, and is no number before."""
    end = max(event[1] for event in events) - 1.0
    nowhere = np.nan, 1e300, 1.0
    return changed(events, "odometry", lambda p, at: nowhere if at < 1.2 else (p[0] + 9.0 * (at > end), *p[1:]))


def clock(events):
    """The computer's clock is set by 30 years while the robot stands, as where it has no battery."""
    return [(name, at + 1e9 * (at > 1.2), *args) for name, at, *args in events]


def in_a_map(*steps):
    """tf has a map in which the odometry's frame is turned; it is moved by these steps [m], a second after another."""

    def change(events):
        poses = [(float(np.sum(steps[:n])), 0.0, 0.3) for n in range(len(steps) + 1)]
        placed = [("transform", 0.5 + n, "map", "odom", pose, {}) for n, pose in enumerate(poses)]
        return [*events, *placed]

    return change


def person(events):
    """Somebody stands 1.5 m ahead for the first two seconds."""
    first = min(event[1] for event in events if event[0] == "scan")
    ahead = np.abs(np.arange(720) - 360) < 25
    return changed(events, "scan", lambda r, at: np.where(ahead & (at < first + 2.0), np.minimum(r, 1.5), r))


def zeros(events):
    return changed(events, "scan", lambda ranges, at: np.where(np.asarray(ranges) < 4.0, ranges, 0.0))


def hanging(events):
    """The scanner hangs upside down, as tf says; the first scans are empty."""
    hangs = ("transform", 0.5, "base_link", JACKAL.laser.frame, (0.055, 0.0, 0.0), {"inverted": True})
    return [hangs, *changed(events, "scan", lambda ranges, at: np.asarray(ranges)[::-1] if at > 1.1 else [])]


def often(events):
    """The goal is sent every second, in a frame that tf does not know."""
    (goal,) = (args for name, _, *args in events if name == "goal")
    more = [("goal", 0.9 + n, *goal[:-1], {"frame": "nowhere"}) for n in range(5)]
    return [*without("goal")(events), *more]


@pytest.mark.parametrize(
    ("change", "remark"),
    [
        (without("goal"), "no goal: the course ends where it was farthest from its start"),
        (without("command"), "nothing of the base is measured"),
        (without("parameters"), "values of the robot's files are taken"),
        (jump, "the odometry or its clock jumps 1 times"),
        (clock, "the odometry or its clock jumps 1 times"),
        (in_a_map(0.0, 1.0), "the localisation in map jumps 1 times"),
        (person, "something moved"),
        (hanging, "tf has front_laser at 0.06, 0.00 m, 0.00 rad, upside down"),
        (often, "nothing says where a goal in the frame 'nowhere' is"),
    ],
    ids=["goal", "command", "parameters", "jump", "clock", "map", "person", "laser", "frame"],
)
def test_what_is_wrong_is_one_line_and_the_course_is_found(driven, tmp_path, change, remark):
    found = courses.read([written(tmp_path / "a.bag", change(driven[0]))], JACKAL, copies=0)
    assert [remark in line for line in found.remarks].count(True) == 1, found.remarks
    (course,) = found.courses
    assert course.pace.path_m > 4.0
    assert clearance(found.worlds[0], found.worlds[0].course.path).min() > 0.15
    if change is not jump and change.__name__ != "change":  # nothing where nothing stands
        assert clearance(WORLD, in_world(found.worlds[0].cylinders[:, :2])).max() < 0.2
    lacking = [line for line in found.remarks if "rosbag record" in line]
    assert len(lacking) == (remark.startswith(("no goal", "nothing of", "values")))


def test_a_robots_topics_may_lie_in_a_namespace_or_have_other_names(driven, recorded, tmp_path):
    names = {name: "/two" + topic for name, topic in vars(Tape.topics).items()}
    other = replace(Tape.topics, scan="/laser", command="/nav_vel")
    for name, topics in {"space": TopicNames(**names), "other": other}.items():
        found = courses.read([written(tmp_path / f"{name}.bag", driven[0], topics)], JACKAL, copies=0)
        assert f"{name}.bag: not recorded under" in found.remarks[0]
        assert f"read instead: {topics.scan}, " in found.remarks[0]
        assert found.courses[0].pace == recorded.courses[0].pace
        assert found.fields == recorded.fields


def test_of_two_odometries_that_have_other_names_the_one_with_more_messages_is_read():
    there = {"/front/scan": ("LaserScan", 9), "/wheels/odom": ("Odometry", 9), "/odometry/filtered": ("Odometry", 18)}
    connections = [SimpleNamespace(topic=t, msgtype=f"x/{kind}", msgcount=n) for t, (kind, n) in there.items()]
    found = TopicNames(odometry="/odom").found(connections)
    assert (found.scan, found.odometry) == ("/front/scan", "/odometry/filtered")


def test_a_drive_on_which_the_odometry_drew_no_error_does_not_say_that_it_has_none(driven, tmp_path):
    found = courses.read([written(tmp_path / "a.bag", in_a_map(0.0, 0.0)(driven[0]))], JACKAL, copies=0)
    assert found.fields["odometry", "scale_error"].value < 0.001
    assert not {name for section, name in found.new if section == "odometry"} & {"scale_error", "heading_drift"}


def test_poses_may_be_in_a_map_or_come_from_tf_alone(driven, tmp_path):
    mapped = courses.read([written(tmp_path / "map.bag", in_a_map(0.1, 0.0)(driven[0]))], JACKAL, copies=0)
    assert mapped.worlds[0].course.start[2] == pytest.approx(START[2] + 0.3, abs=0.04)
    assert 0.0 < mapped.fields["odometry", "scale_error"].value < 0.05
    poses = [
        ("transform", at, "odom", "base_link", *args[:1], {}) for name, at, *args in driven[0] if name == "odometry"
    ]
    by_tf = courses.read(
        [written(tmp_path / "tf.bag", [*without("odometry", "result", "status")(driven[0]), *poses])], JACKAL, copies=0
    )
    assert by_tf.courses[0].pace.time_s == pytest.approx(driven[1].time_s, abs=0.8)
    assert by_tf.fields["simulation", "command_delay"].value == pytest.approx(DELAY, abs=0.05)


def test_of_a_bag_that_is_cut_short_what_is_whole_is_read(driven, recorded, tmp_path):
    path = written(tmp_path / "cut.bag", driven[0], chunk=1 << 15)
    path.write_bytes(path.read_bytes()[: int(0.6 * path.stat().st_size)])
    found = courses.read([path], JACKAL, copies=0)
    assert "cut.bag: it is cut short: what is whole of it is read" in found.remarks
    assert 1.5 < found.courses[0].pace.path_m < recorded.courses[0].pace.path_m


def test_each_goal_of_a_bag_is_a_course(driven, tmp_path):
    later = [(name, 5.0, *args) if name == "goal" else (name, at, *args) for name, at, *args in driven[0]]
    first = ("goal", 0.9, (1.5, 1.2, 0.0), {})
    found = courses.read([written(tmp_path / "two.bag", [first, *later])], JACKAL, copies=0)
    assert [world.name for world in found.worlds] == ["two_1", "two_1-wall", "two_2", "two_2-wall"]
    one, two = (course.worlds[0].course for course in found.courses)
    assert np.hypot(*np.subtract(one.goal[:2], two.start[:2])) < one.goal_tolerance + 0.3
    assert one.goal_tolerance < 1.0
    assert two.goal[:2] == pytest.approx((4.5, 1.4), abs=0.01)
    assert found.courses[0].pace.path_m + found.courses[1].pace.path_m < 6.0


def test_bags_that_cannot_be_used_are_remarks_beside_one_that_can(driven, tmp_path):
    written(tmp_path / "good.bag", zeros(driven[0]))
    for name, change in {"stands": standing, "blind": without("scan"), "lost": without("odometry")}.items():
        written(tmp_path / f"{name}.bag", change(driven[0]))
    (tmp_path / "cut.bag").write_bytes((tmp_path / "good.bag").read_bytes()[:9000])
    found = courses.read([tmp_path], JACKAL, copies=0)
    assert [course.name for course in found.courses] == ["good"]
    assert found.robot.laser.no_return == 0.0
    for name, remark in (
        ("stands", "the robot stands"),
        ("blind", "nothing on /front/scan"),
        ("lost", "nothing on /odometry/filtered nor in /tf"),
        ("cut", "damaged"),
    ):
        assert any(line.startswith(f"{name}.bag: ") and remark in line for line in found.remarks), found.remarks
    with pytest.raises(BagError, match="blind.bag: nothing on .* rosbag record"):
        courses.read([tmp_path / "blind.bag"], JACKAL)


def test_a_measured_value_that_contradicts_the_robot_is_left_out(driven, tmp_path):
    robot = replace(JACKAL, laser=JACKAL.laser.model_copy(update={"range_max": 60.0}))
    far = changed(driven[0], "scan", lambda ranges, at: np.where(np.asarray(ranges) < 4.0, ranges, 40.0))
    found = courses.read([written(tmp_path / "a.bag", far)], robot, copies=0)
    assert found.remarks[0].startswith("measured laser.no_return 40 m"), found.remarks
    assert "is left out: laser.no_return is 40" in found.remarks[0]
    assert found.robot.laser.no_return is None
    assert ("laser", "no_return") not in found.new


def test_a_base_is_known_by_how_it_follows():
    rng, step = np.random.default_rng(0), 0.05
    time = np.arange(0.0, 40.0, step)
    told = np.repeat(rng.uniform(0.0, 1.0, 20), 40)
    at, now, lagged, speeds = np.arange(0.0, 40.0, 0.01), 0.0, 0.0, []
    for t in at:
        wanted = told[max(0, int((t - 0.12) / step + 1e-6))] if t >= 0.12 else 0.0
        now += min(max(wanted - now, -0.01 * 1.3), 0.01 * 0.7)
        lagged += 0.01 / 0.08 * (now - lagged)
        speeds.append(lagged + rng.normal(0.0, 0.003))
    how = measured.response(time, told, at, np.array(speeds))
    assert (how.faster, how.slower) == (0.7, 1.3)
    assert (how.delay, how.lag) == (pytest.approx(0.12, abs=0.02), pytest.approx(0.08, abs=0.03))
    turns = measured.followed(time, told, at, 1.35 * np.array(speeds), 1.0)
    assert np.median(turns[:, 1]) == pytest.approx(1.35, abs=0.03)
    assert np.abs(turns[:, 0]).min() >= measured.LEAST


def test_what_moves_and_what_is_not_seen_is_told_from_what_stands():
    """A wall 2 m ahead over 90 degrees; for the first 20 of 60 scans a post stands in front of it."""
    angles = np.linspace(-np.pi / 4, np.pi / 4, 181)
    wall = 2.0 / np.cos(angles)
    post = np.where(np.abs(angles) < 0.1, 1.0, wall)
    noisy = np.where(np.arange(181) == 40, wall - 0.08, wall)  # two beams end in front of the wall
    seen_by = [post if n < 20 else noisy if n in (30, 40) else wall for n in range(60)]
    scans = [Scan((0.0, 0.0, 0.0), angles[0], angles[1] - angles[0], ranges) for ranges in seen_by]
    driven = np.zeros((1, 2))
    place = seen(scans, driven, 0.2, 0.3)
    assert place.gone > 0.0
    np.testing.assert_allclose(place.surfaces[:, 0], 2.05, atol=0.02)
    assert place.surfaces[:, 1].min() < -1.9
    assert place.surfaces[:, 1].max() > 1.9
    sides = np.abs(np.arctan2(place.unseen[:, 1], place.unseen[:, 0]))
    assert len(place.unseen) > 20
    assert sides.min() > np.pi / 4 - 0.15
    still = seen(scans[:20], driven, 0.2, 0.3)  # nothing has been seen behind it yet
    assert (np.abs(still.surfaces[:, 0] - 1.04) < 0.05).any()
    assert still.gone == 0.0
