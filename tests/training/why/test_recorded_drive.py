"""Tests of what the replay reads from bags: plans, names, frames, poses and the laser's place from
tf.
"""

from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from applr_ros1.common.angles import compose, inverse, quaternion_of
from applr_ros1.common.errors import ApplrError
from applr_ros1.drives import places
from applr_ros1.drives.columns import COLUMNS, Sender, TopicNames
from applr_ros1.drives.drive import (
    Commands,
    Drive,
    Goal,
    Motion,
    Plans,
    Scans,
    Transforms,
    Verdicts,
)
from applr_ros1.drives.frames import FrameTree
from applr_ros1.drives.paths import path_of
from applr_ros1.robots import JACKAL
from applr_ros1.why import fitting
from applr_ros1.why.black_box.description import DescribedRobot, text_of
from applr_ros1.why.fitting import plans_of
from applr_ros1.why.outside import OTHER_PLANNER
from applr_ros1.why.replay import replay_of
from applr_ros1.why.rerun import RerunPlanner
from tests.support.bags import read, write
from tests.support.drives import simulated, until
from training.bags.maker import Maker
from training.bags.read import BagError
from training.bags.write import BagWriter
from training.why import recorded
from training.why.recorded import (
    BagAnswerOptions,
    recording_of,
    with_description,
)

PLANNER = RerunPlanner(JACKAL)


@pytest.fixture(scope="module")
def driven():
    """Return a drive of six seconds, with the plans of both planners."""
    drive, _ = simulated(JACKAL, "generated:40", limit=6)
    return replace(drive, frames={})


def read_back(path, **options):
    """Return the recording that the replay reads from a bag."""
    given_options = BagAnswerOptions(**options)
    return recording_of(path, given_options, RerunPlanner(given_options.robot))


def fitted(drive):
    """Return the recording of a drive of the Jackal whose columns are made to fit."""
    return fitting.fitted(drive, PLANNER, JACKAL)


def followed(drive, tree=None):
    """Return the plans that were followed in a drive, with frames as in a tree."""
    tree = tree or FrameTree(None)
    route_frame = places.route_frame(drive, tree, drive.planned)
    return plans_of(drive, drive.planned, drive.odometry, route_frame, PLANNER)


def through_a_bag(path, drive):
    """Return the recording of a drive as it is read from the bag that it is written to."""
    return read_back(write(path, drive))


def share(recording):
    """Return the share of a recording's commands that the replay reproduces."""
    return replay_of(recording).share


def links(rows, is_static=False):
    """Return transforms from rows (time, parent, child, (x, y, yaw))."""
    stamps, parents, children, poses = zip(*rows)
    times = np.array(stamps, float)
    places = [(x, y, 0.0, *quaternion_of(yaw)) for x, y, yaw in poses]
    return Transforms(
        times,
        times,
        parent=list(parents),
        child=list(children),
        place=np.array(places),
        is_static=[is_static] * len(rows),
    )


def joined(*parts):
    """Return several transforms as one."""
    parents = []
    children = []
    is_static = []
    for transforms in parts:
        parents += transforms.parent
        children += transforms.child
        is_static += transforms.is_static
    return Transforms(
        np.concatenate([transforms.time for transforms in parts]),
        np.concatenate([transforms.stamp for transforms in parts]),
        parents,
        children,
        np.concatenate([transforms.place for transforms in parts]),
        is_static,
    )


def robots_links(motion, parent="odom", child="base_link"):
    """Return transforms of a robot with the poses of a motion."""
    rows = []
    for time, pose in zip(motion.time.tolist(), motion.pose.tolist()):
        rows.append((time, parent, child, pose))
    return links(rows)


def laser_link(pose, rotation=None, frame="front_laser"):
    """Return the static place of a laser in base_link."""
    link = links([(0.0, "base_link", frame, pose)], is_static=True)
    if rotation is not None:
        link.place[0, 3:] = rotation
    return link


def drifting(motion):
    """Return odometry that drifts by 5 percent of the way along x."""
    pose = motion.pose.copy()
    pose[:, :2] *= 1.05
    return replace(motion, pose=pose)


# -- plans -----------------------------------------------------------------------------------------
@pytest.mark.heavy
def test_the_plan_comes_from_the_global_planner_where_the_local_planners_is_missing(
    driven, tmp_path
):
    with_routes_alone = through_a_bag(tmp_path / "navfn.bag", replace(driven, plans=None))
    assert with_routes_alone.drive.planners == []
    assert share(with_routes_alone) > 0.97
    # A bag with both has the local planner's plan, not one that is rebuilt.
    with_both = through_a_bag(tmp_path / "both.bag", driven)
    assert np.allclose(with_both.plans.path[5], driven.plans.path[5])


@pytest.mark.heavy
def test_of_navfns_two_plans_of_one_stamp_the_second_is_followed(driven, tmp_path):
    """Navfn publishes each plan without the goal's pose first."""
    published_paths = []
    for path in driven.routes.path:
        published_paths += [path[:-1], path]
    times = np.repeat(driven.routes.time, 2)
    drive = replace(driven, plans=None, routes=Plans(times, published_paths))

    read_back_drive = read(write(tmp_path / "twice.bag", drive))

    assert len(read_back_drive.routes) == len(driven.routes)
    assert np.allclose(read_back_drive.routes.path[3], driven.routes.path[3])


@pytest.mark.heavy
def test_a_plan_that_came_during_a_cycle_may_be_too_late_for_it(driven, tmp_path):
    """Each plan comes 5 ms before the command of the cycle before its own."""
    # Cycles are 50 ms apart, and the 5 ms are within the time that a cycle may take.
    early_routes = Plans(driven.routes.time - 0.055, driven.routes.path)
    drive = replace(driven, plans=None, routes=early_routes)
    assert share(through_a_bag(tmp_path / "early.bag", drive)) > 0.97


def straight(seconds, metres):
    """Return a drive along x that follows one route from 0 to 10 m."""
    times = np.linspace(0.0, seconds, 21)
    poses = np.zeros((21, 3))
    poses[:, 0] = np.linspace(0.0, metres, 21)
    route = np.zeros((401, 3))
    route[:, 0] = np.linspace(0.0, 10.0, 401)
    twists = np.tile([0.5, 0.0], (21, 1))
    return Drive(
        odometry=Motion(times, times, poses, twists),
        planned=Commands(times, twists),
        routes=Plans(np.array([0.0]), [route]),
        frames={"routes": ["odom"]},
    )


def test_points_that_were_pruned_stay_away_when_the_robot_drives_back():
    drive = straight(10.0, 5.0)
    # The last pose lies 4.25 m behind the one before it, at 4.75 m.
    drive.odometry.pose[-1, 0] = 0.5
    plans = followed(drive)
    first_plan = plans.path[0]
    last_plan = plans.path[-1]
    assert first_plan[0, 0] == 0.0
    # move_base pruned up to 1 m behind the robot, and pruned points do not come back.
    assert last_plan[0, 0] == pytest.approx(3.75, abs=0.3)


def test_empty_plans_alone_are_replaced_by_parts_of_the_global_planners(driven):
    drive = replace(until(driven, 2.0), frames={"routes": ["odom"]})
    assert followed(drive) is drive.plans

    empty_paths = [np.zeros((0, 3))] * len(drive.plans)
    empty_plans = replace(drive.plans, path=empty_paths)
    drive.plans = empty_plans
    plans = followed(drive)
    assert len(plans)
    assert all(map(len, plans.path))

    # Without the global planner's, there is nothing to replace them with.
    drive.routes = None
    assert followed(drive) is empty_plans


def test_a_plan_in_another_frame_is_moved_by_tf_and_refused_without(driven):
    drive = straight(2.0, 0.5)
    drive.frames["routes"] = ["map"]
    with pytest.raises(Exception, match="the plan is in map, the odometry in odom: record /tf"):
        followed(drive)

    odom_in_map = (3.0, 0.0, 0.6)
    tree = FrameTree(links([(0.0, "map", "odom", odom_in_map)], is_static=True))
    plans = followed(drive, tree)

    # A point of the route in map lies on the plan in odom, with its heading there.
    x, y, yaw = compose(inverse(odom_in_map), (4.0, 0.0, 0.0))
    plan = plans.path[0]
    distances = np.hypot(plan[:, 0] - x, plan[:, 1] - y)
    assert distances.min() < 1e-9
    assert plan[distances.argmin(), 2] == pytest.approx(yaw)


def test_commands_without_a_plan_or_after_the_goal_have_none():
    drive = straight(2.0, 1.0)
    drive.routes = Plans(np.array([0.5]), drive.routes.path)
    # The route comes after 0.5 s, and the second of two goals is reached after 1.5 s of the 2 s.
    drive.goals = [Goal("g", 0.0, 0.8), Goal("h", 0.9, 1.5)]
    times = followed(drive).time
    assert times.min() == pytest.approx(0.5)
    assert times.max() == pytest.approx(1.5)


def put_plan(writer, time, frame, path):
    """Write a plan that a local planner followed."""
    values = {"time": time, "path": path}
    writer.put("plans", values, Sender(JACKAL, frame), "TrajectoryPlannerROS")


def serialised(frames, turns):
    """Return a path with poses of some frames and quaternions (n, 4): its message, and as bytes."""
    maker = Maker()
    poses = []
    for frame, turn in zip(frames, turns, strict=True):
        pose = {
            "position": {"x": 1.0, "y": 2.0},
            "orientation": dict(zip("xyzw", turn, strict=True)),
        }
        poses.append({"header": {"stamp": 2.0, "frame_id": frame}, "pose": pose})
    message_type = "nav_msgs/msg/Path"
    header = {"stamp": 2.0, "frame_id": "/map"}
    message = maker.make(message_type, {"header": header, "poses": poses})
    raw_message = maker.store.serialize_ros1(message, message_type)
    return message, raw_message


def test_a_path_read_at_once_has_the_yaws_of_rotations_that_are_not_level():
    turns = np.random.default_rng(0).normal(size=(9, 4))
    message, raw_message = serialised(["map"] * 9, turns)
    row = path_of(raw_message)
    (rosbags_row,) = COLUMNS["routes"].unpack(message)
    assert row["stamp"] == rosbags_row["stamp"] == 2_000_000_000
    assert row["frame"] == rosbags_row["frame"] == "map"
    assert np.allclose(row["path"], rosbags_row["path"], rtol=0.0, atol=1e-15)


def test_poses_of_frames_of_unequal_lengths_are_left_to_rosbags():
    """Lengths of 3, 2 and 4 add up as three of 3 would."""
    _, raw_message = serialised(["map", "ab", "odom"], np.ones((3, 4)))
    assert path_of(raw_message) is None


def test_a_damaged_path_is_left_to_rosbags():
    nothing = b""
    cut_header = b"\0" * 12
    absurd_lengths = b"\xff" * 40
    header_without_poses = b"\0" * 16 + b"\5\0\0\0" + b"\0" * 99
    for raw_message in (nothing, cut_header, absurd_lengths, header_without_poses):
        assert path_of(raw_message) is None
    # All zeros is a whole message: an empty path in a frame without a name.
    assert len(path_of(b"\0" * 20)["path"]) == 0


# -- the black box's description -------------------------------------------------------------------
@pytest.mark.parametrize("is_known", [True, False])
def test_nothing_is_driven_with_a_body_that_nobody_described_or_gave(monkeypatch, is_known):
    text = text_of(DescribedRobot(JACKAL, TopicNames.of(JACKAL), is_known))
    bag = SimpleNamespace(text_on=lambda topic: text)
    monkeypatch.setattr(recorded, "opened", lambda path: nullcontext(bag))

    described = with_description(Path("stop.bag"), BagAnswerOptions())
    given = with_description(Path("stop.bag"), BagAnswerOptions(robot=JACKAL))

    assert described.quick == (not is_known)
    assert not given.quick


# -- names -----------------------------------------------------------------------------------------
def names(**changed):
    """Return the Jackal's topics with some of them changed."""
    return replace(TopicNames.of(JACKAL), **changed)


def test_contacts_in_a_bag_are_read(driven, tmp_path):
    touched = replace(until(driven, 1.0), contacts=np.array([0.5]))
    recording = through_a_bag(tmp_path / "touched.bag", touched)
    np.testing.assert_allclose(recording.drive.contacts, [0.5], atol=0.05)


def test_move_base_is_found_by_its_plans(driven, tmp_path):
    with_both = until(driven, 1.0)
    with_routes_alone = replace(with_both, plans=None)
    for number, namespace in enumerate(("/move_base_node", "/robot1/move_base")):
        topics = names(move_base=namespace)
        for kind, drive in (("both", with_both), ("routes", with_routes_alone)):
            bag_path = write(tmp_path / f"{kind}{number}.bag", drive, topics=topics)
            # One second at 20 Hz.
            assert len(read_back(bag_path).plans) > 10


def test_topics_in_the_namespace_around_move_base_are_found(driven, bag_path):
    topics = names(
        move_base="/robot1/move_base",
        scan="/robot1/front/scan",
        odometry="/robot1/odometry/filtered",
        command="/robot1/cmd_vel",
        monitor="/robot1/collision_monitor",
    )
    verdicts = Verdicts(np.zeros(1), ["stop"], ["a wall"])
    write(bag_path, replace(until(driven, 1.0), verdicts=verdicts), topics=topics)
    recording = read_back(bag_path)
    assert len(recording.scans) > 3
    assert recording.drive.verdicts.reason == ["a wall"]


def test_of_several_move_base_one_is_asked_for(driven, tmp_path):
    bag_path = tmp_path / "two.bag"
    with BagWriter(bag_path, JACKAL, names(move_base="/a/move_base")) as writer:
        writer.write(until(driven, 1.0))
        writer.topics = names(move_base="/b/move_base")
        put_plan(writer, 9.0, "odom", driven.plans.path[0])

    problem = "plans of /a/move_base and of /b/move_base: give --move-base"
    with pytest.raises(BagError, match=problem):
        read_back(bag_path)
    assert len(read_back(bag_path, move_base="/a/move_base").plans) > 10


@pytest.mark.parametrize(
    ("topics", "problem"),
    [
        (
            {"command": "/cmd_vel_mux/input/navi"},
            "/cmd_vel: .* --command; the bag has geometry_msgs/msg/Twist on /cmd_vel_mux",
        ),
        (
            {"scan": "/scan"},
            "/front/scan: .* or give --scan; the bag has sensor_msgs/msg/LaserScan on /scan",
        ),
        (
            {"odometry": "/odom"},
            "/odometry/filtered: .* or give --odometry; the bag has nav_msgs/msg/Odometry on /odom",
        ),
    ],
)
def test_a_missing_topic_is_named_with_its_option_and_the_bags_topics(
    driven, bag_path, topics, problem
):
    drive = replace(until(driven, 1.0), planned=None)
    write(bag_path, drive, topics=names(**topics))
    with pytest.raises(BagError, match=f"no messages on {problem}"):
        read_back(bag_path)
    assert len(read_back(bag_path, **topics).plans) > 10


def test_a_topic_of_another_type_is_not_read(driven, bag_path):
    drive = replace(until(driven, 1.0), planned=None)
    # The topic of the commands has the name of the scan's; --command leads to the scan's Twist.
    topics = names(command="/front/scan", scan="/scan")
    write(bag_path, drive, topics=topics)
    with pytest.raises(BagError, match="/front/scan has messages of geometry_msgs/msg/Twist"):
        read_back(bag_path, command="/front/scan")


def test_of_another_planner_the_robot_that_drove_is_asked_for(driven, bag_path):
    drive = replace(until(driven, 1.0), planners=["DWAPlannerROS"])
    write(bag_path, drive)
    with pytest.raises(BagError, match="DWAPlannerROS drove, .* give the robot that drove"):
        read_back(bag_path)


@pytest.mark.parametrize("given", [{}, {"robot": JACKAL}])
def test_a_planner_that_is_not_replayed_is_said_at_once_and_no_robot_asked_for(
    driven, bag_path, given
):
    drive = replace(until(driven, 1.0), planners=["TebLocalPlannerROS"])
    write(bag_path, drive)
    with pytest.raises(BagError) as refusal:
        read_back(bag_path, **given)
    assert str(refusal.value) == f"{bag_path}: {OTHER_PLANNER}"


def test_of_such_a_planner_odometry_on_another_topic_is_named(driven, bag_path):
    """The topics of a robot that was not given are those of the Jackal."""
    drive = replace(until(driven, 1.0), planners=["TebLocalPlannerROS"])
    write(bag_path, drive, topics=TopicNames(odometry="/odom"))
    with pytest.raises(BagError) as refusal:
        read_back(bag_path)
    assert str(refusal.value) == (
        f"{bag_path}: {OTHER_PLANNER}; what else happened is seen in the odometry: no messages on "
        "/odometry/filtered: correct topics in robot.yaml, or give --odometry; the bag has "
        "nav_msgs/msg/Odometry on /odom"
    )
    with pytest.raises(BagError) as refusal:
        read_back(bag_path, odometry="/odom")
    assert str(refusal.value) == f"{bag_path}: {OTHER_PLANNER}"


# -- clocks ----------------------------------------------------------------------------------------
def with_later_stamps(drive, **seconds):
    """Return a drive in which the messages of some columns are stamped so much later [s]."""
    columns = {}
    for column, later in seconds.items():
        rows = getattr(drive, column)
        columns[column] = replace(rows, stamp=rows.stamp + later)
    return replace(drive, **columns)


@pytest.mark.parametrize(("later", "words"), [(1234.0, "after"), (-1234.0, "before")])
def test_scans_in_the_lasers_own_time_are_refused_as_tf_drops_them(driven, later, words):
    drive = with_later_stamps(framed(driven), scans=later)
    with pytest.raises(ApplrError) as refusal:
        fitted(drive)
    assert str(refusal.value) == (
        f"scans are stamped 1,234.0 s {words} the odometry: the clocks differ; "
        "set the driver of the laser to the computer's time, or tf drops the scans"
    )


def test_scans_that_tf_places_late_are_named(driven):
    drive = fitted(with_later_stamps(framed(driven), scans=-3.0))
    (note,) = drive.drive.notes
    assert note.startswith("scans are stamped 3.0 s before the odometry: the clocks differ")
    on_time = fitted(with_later_stamps(framed(driven), scans=-0.2))
    assert on_time.drive.notes == []


def test_velocities_of_odometry_in_the_bases_own_time_are_those_that_came_with_the_poses(driven):
    """The planner takes the latest of both, whatever their stamps."""
    drive = framed(driven)
    drive.transforms = robots_links(drive.odometry)
    in_own_time = fitted(with_later_stamps(drive, odometry=500.0))
    (note,) = in_own_time.drive.notes
    assert note.startswith("the odometry is stamped 500.0 s after tf: the clocks differ")
    in_one_time = fitted(drive)
    assert np.array_equal(in_own_time.odometry.twist, in_one_time.odometry.twist)
    assert np.array_equal(in_own_time.odometry.stamp, in_one_time.odometry.stamp)


# -- frames ----------------------------------------------------------------------------------------
def framed(drive):
    """Return a simulated drive with the frames of its columns, as a bag has them."""
    frames = {"odometry": ["odom"], "scans": [JACKAL.laser.frame], "plans": ["odom"]}
    return replace(drive, frames={**frames, "routes": ["odom"]})


def in_frames(path, drive, **frames):
    """Write a drive whose messages have the frames of robot.yaml, or others."""
    robot = JACKAL
    if "laser" in frames:
        laser = robot.laser.model_copy(update={"frame": frames["laser"]})
        robot = replace(robot, laser=laser)
    return write(path, replace(drive, frame=frames.get("odom", "odom")), robot=robot)


def test_a_plan_in_another_frame_than_the_odometry_is_refused(driven, bag_path):
    with BagWriter(bag_path, JACKAL, names()) as writer:
        without_plans = replace(until(driven, 1.0), plans=None, routes=None)
        writer.write(without_plans)
        put_plan(writer, 1.5, "map", driven.plans.path[0])
    with pytest.raises(BagError) as refusal:
        read_back(bag_path)
    problem = "the plan is in map, the odometry in odom: record /tf and /tf_static"
    assert str(refusal.value).endswith(problem)


def test_a_plan_without_a_frame_is_in_that_of_the_odometry(driven, bag_path):
    with BagWriter(bag_path, JACKAL, names()) as writer:
        without_plans = replace(until(driven, 1.0), plans=None, routes=None)
        writer.write(without_plans)
        put_plan(writer, 1.5, "", driven.plans.path[0])
    (plan,) = read_back(bag_path).plans.path
    assert np.allclose(plan, driven.plans.path[0])


def test_a_local_costmap_in_another_frame_than_the_odometry_is_placed_by_tf(driven, bag_path):
    """The map lies a whole number of cells away, so that the costmap has the same cells."""
    odom_in_map = (-3.2, 1.6, 0.0)
    three_seconds = replace(until(driven, 3.0), routes=None)
    plans = three_seconds.plans
    odometry = three_seconds.odometry
    plans_in_map = [path + odom_in_map for path in plans.path]
    transforms = joined(
        robots_links(odometry),
        links([(0.0, "map", "odom", odom_in_map)], is_static=True),
    )
    with BagWriter(bag_path, JACKAL, names()) as writer:
        writer.write(replace(three_seconds, plans=None, transforms=transforms))
        # The writer begins a bag at 1 s of ROS time.
        stamps = 1.0 + plans.time - odometry.time[0]
        for stamp, path in zip(stamps, plans_in_map, strict=True):
            put_plan(writer, stamp, "map", path)

    read_back_drive = read_back(bag_path)

    assert read_back_drive.drive.frame == "map"
    assert np.allclose(read_back_drive.odometry.pose, odometry.pose + odom_in_map)
    assert np.allclose(read_back_drive.plans.path[3], plans_in_map[3])
    assert share(read_back_drive) > 0.9


@pytest.mark.parametrize("prefix", ["robot1/", "robot1_"])
def test_a_prefix_that_all_frames_share_is_taken_off(driven, tmp_path, prefix):
    one_second = until(driven, 1.0)
    odometry_of_tf = drifting(one_second.odometry)
    transforms = robots_links(odometry_of_tf, f"{prefix}odom", f"{prefix}base_link")
    drive = replace(one_second, transforms=transforms)
    bag_path = in_frames(
        tmp_path / "a.bag", drive, odom=f"{prefix}odom", laser=f"{prefix}front_laser"
    )
    read_back_drive = read_back(bag_path)
    assert np.allclose(read_back_drive.odometry.pose, odometry_of_tf.pose)

    # A prefix of the scans alone is no prefix of the robot: it may be another robot's laser.
    bag_path = in_frames(tmp_path / "b.bag", drive, laser=f"{prefix}front_laser")
    with pytest.raises(BagError, match=f"scans in {prefix}front_laser, jackal has front_laser"):
        read_back(bag_path)


# -- poses -----------------------------------------------------------------------------------------
@pytest.mark.heavy
def test_the_pose_is_tfs_and_the_velocity_the_topics(driven, tmp_path):
    drive = replace(driven, odometry=drifting(driven.odometry), transforms=None)
    without_tf = through_a_bag(tmp_path / "a.bag", drive)
    drive.transforms = robots_links(driven.odometry)
    with_tf = through_a_bag(tmp_path / "b.bag", drive)
    # The drift puts the robot 5 % of its way from where its planner had it.
    assert share(without_tf) < 0.8
    assert share(with_tf) > 0.97
    assert np.allclose(with_tf.odometry.pose, driven.odometry.pose)
    assert np.allclose(with_tf.odometry.twist, driven.odometry.twist)
    (note,) = with_tf.drive.notes
    assert note.startswith("the odometry topic is not what tf shows: up to 0.")


def test_poses_are_composed_along_a_chain_of_links(driven, bag_path):
    """odom -> base_footprint moves, base_footprint -> base_link is static."""
    base_in_footprint = (0.1, -0.2, 0.3)
    footprint_in_base = inverse(base_in_footprint)
    footprint_poses = []
    for base_pose in driven.odometry.pose.tolist():
        footprint_poses.append(compose(tuple(base_pose), footprint_in_base))
    footprint_motion = replace(driven.odometry, pose=np.array(footprint_poses))
    chain = joined(
        links([(0.0, "base_footprint", "base_link", base_in_footprint)], is_static=True),
        robots_links(footprint_motion, child="base_footprint"),
    )
    read_back_drive = through_a_bag(bag_path, replace(driven, transforms=chain))
    assert np.allclose(read_back_drive.odometry.pose, driven.odometry.pose)


def test_a_quaternion_and_its_opposite_are_one_rotation():
    transforms = links(
        [
            (0.0, "odom", "base_link", (0, 0, 0.2)),
            (1.0, "odom", "base_link", (0, 0, 0.4)),
        ]
    )
    # Averaged as they are, both would cancel: the yaw in between would be noise.
    transforms.place[1, 3:] *= -1.0
    middle_place = FrameTree(transforms).place("odom", "base_link", np.array([0.5]))
    assert middle_place.planar[0, 2] == pytest.approx(0.3)


def test_a_frame_is_placed_in_one_of_another_branch():
    """As a laser on the body, beside a base frame that is on the body as well."""
    base_pose = (2.0, -1.0, 0.5)
    laser_pose = (0.5, 1.0, -2.0)
    transforms = links(
        [
            (0.0, "body", "base", base_pose),
            (0.0, "body", "laser", laser_pose),
        ],
        is_static=True,
    )
    laser_in_base = FrameTree(transforms).place("base", "laser", np.zeros(1))
    assert laser_in_base.planar[0] == pytest.approx(compose(inverse(base_pose), laser_pose))


def test_more_frequent_poses_of_tf_are_all_taken(driven, bag_path):
    two_seconds = until(driven, 2.0)
    odometry = two_seconds.odometry
    every_second = odometry.part(slice(0, None, 2))
    drive = replace(
        two_seconds,
        odometry=every_second,
        transforms=robots_links(odometry),
    )
    read_back_drive = through_a_bag(bag_path, drive)
    assert np.allclose(read_back_drive.odometry.pose, odometry.pose)
    assert np.allclose(read_back_drive.odometry.twist[::2], every_second.twist)
    # The topic and tf agree.
    assert read_back_drive.drive.notes == []


def test_frames_in_a_circle_and_rotations_of_no_length_are_no_pose(driven, tmp_path):
    circle = joined(
        links([(0.0, "b", "base_link", (0, 0, 0))]),
        links([(0.0, "base_link", "b", (0, 0, 0))]),
    )
    one_second = until(driven, 1.0)
    topic_poses = one_second.odometry.pose
    in_circle = replace(one_second, transforms=circle)
    read_back_drive = through_a_bag(tmp_path / "a.bag", in_circle)
    assert np.allclose(read_back_drive.odometry.pose, topic_poses)

    # These would move the robot, if they were taken.
    no_rotations = robots_links(drifting(one_second.odometry))
    no_rotations.place[:, 3:] = 0.0
    without_rotations = replace(one_second, transforms=no_rotations)
    read_back_drive = through_a_bag(tmp_path / "b.bag", without_rotations)
    assert np.allclose(read_back_drive.odometry.pose, topic_poses)


# -- velocities ------------------------------------------------------------------------------------
def sent_to_the_end(metres, twist):
    """Return a drive of ten seconds along x with this velocity (v, w) in its odometry."""
    drive = straight(10.0, metres)
    times = np.arange(201) / 20.0
    poses = np.zeros((201, 3))
    poses[:, 0] = np.linspace(0.0, metres, 201)
    drive.odometry = Motion(times, times, poses, np.tile(twist, (201, 1)))
    drive.scans = Scans(times[:1], times[:1], np.array([[0.0, 0.1, 0.1, 5.0]]), [np.ones(3)])
    drive.frames = {"odometry": ["odom"], "scans": [JACKAL.laser.frame], "routes": ["odom"]}
    drive.goals = [Goal("g", 0.0, 10.0)]
    return drive


def test_of_odometry_without_twists_the_poses_are_believed():
    drive = fitted(sent_to_the_end(1.7, (0.0, 0.0)))
    assert drive.drive.notes == [
        "the odometry's velocity is 0 while its pose moves at 0.17 m/s: "
        "the planner takes the robot to stand; fill twist"
    ]
    # Events are seen in the motion of the poses, and the planner is given what it was given.
    assert drive.odometry.twist[20:-20, 0] == pytest.approx(0.17)
    assert drive.measured(100) == (tuple(drive.odometry.pose[100]), (0.0, 0.0))


def test_velocities_by_poses_are_known_at_the_begin_and_after_a_gap_in_the_odometry():
    # Given: steady motion by poses without twists, a second of which is missing
    drive = sent_to_the_end(1.7, (0.0, 0.0))
    motion = drive.odometry
    is_kept = (motion.stamp < 4.0) | (motion.stamp > 5.0)
    drive.odometry = Motion(
        motion.time[is_kept], motion.stamp[is_kept], motion.pose[is_kept], motion.twist[is_kept]
    )
    # Then: no message takes the robot to stand
    assert fitted(drive).odometry.twist[:, 0] == pytest.approx(0.17)


def test_odometry_too_rare_to_show_a_velocity_keeps_its_twists():
    drive = sent_to_the_end(1.7, (0.0, 0.0))
    motion = drive.odometry
    rows = np.arange(0, len(motion), 16)  # every 0.8 s
    drive.odometry = Motion(
        motion.time[rows], motion.stamp[rows], motion.pose[rows], motion.twist[rows]
    )
    fitted_drive = fitted(drive)
    assert len(fitted_drive.drive.notes) == 1
    assert not fitted_drive.odometry.twist.any()


def test_of_odometry_without_poses_the_twists_are_believed():
    drive = fitted(sent_to_the_end(0.0, (0.3, 0.0)))
    (note,) = drive.drive.notes
    assert note.startswith("the odometry's pose stays while its velocity is 0.30 m/s")
    assert np.array_equal(np.unique(drive.odometry.twist), [0.0, 0.3])


def test_odometry_that_agrees_is_left_as_it_is():
    original = sent_to_the_end(3.0, (0.3, 0.0))
    drive = fitted(original)
    assert drive.drive.notes == []
    assert drive.odometry is original.odometry


# -- laser -----------------------------------------------------------------------------------------
def test_the_lasers_place_is_tfs(driven, tmp_path):
    one_second = until(driven, 1.0)
    as_in_robot_yaml = replace(one_second, transforms=laser_link(JACKAL.laser.pose))
    unmoved = through_a_bag(tmp_path / "a.bag", as_in_robot_yaml)
    assert unmoved.laser_pose == JACKAL.laser.pose
    assert unmoved.drive.notes == []

    laser_pose = (0.2, 0.1, 0.5)
    drive = replace(one_second, transforms=laser_link(laser_pose))
    moved = through_a_bag(tmp_path / "b.bag", drive)
    assert moved.laser_pose == pytest.approx(laser_pose)
    (note,) = moved.drive.notes
    assert note.startswith("tf has the laser at (0.20, 0.10) m, 0.50 rad, robot.yaml at (0.06")

    # The replay's costmaps get the scan from there. The robot moves a little until its first scan.
    first_pose = tuple(moved.odometry.pose[0])
    expected_pose = compose(first_pose, laser_pose)
    assert moved.scan(0).sensor_pose == pytest.approx(expected_pose, abs=0.02)


def test_a_laser_upside_down_has_its_beams_in_reverse(driven, bag_path):
    """Rotated by pi about x, beam k of n points as beam n - 1 - k of an upright laser."""
    two_seconds = until(driven, 2.0)
    # A symmetric fan would be the same in reverse.
    upright_fan = two_seconds.scans.fan + [0.3, 0.0, 0.0, 0.0]
    upright_scans = replace(two_seconds.scans, fan=upright_fan)
    reversed_ranges = [ranges[::-1].copy() for ranges in upright_scans.ranges]
    # The fan begins where the upright one ends, on the other side.
    first_angles, increments, _, _ = upright_fan.T
    step_count = len(reversed_ranges[0]) - 1
    reversed_fan = upright_fan.copy()
    reversed_fan[:, 0] = -(first_angles + step_count * increments)
    drive = replace(
        two_seconds,
        scans=replace(upright_scans, fan=reversed_fan, ranges=reversed_ranges),
        transforms=laser_link(JACKAL.laser.pose, rotation=(1.0, 0.0, 0.0, 0.0)),
    )
    read_back_drive = through_a_bag(bag_path, drive)
    assert read_back_drive.drive.notes == [
        "the laser is mounted upside down (tf): its beams are taken in reverse"
    ]
    assert np.array_equal(read_back_drive.scans.ranges[3], upright_scans.ranges[3])
    assert np.allclose(read_back_drive.scans.fan, upright_fan, atol=1e-6)


def test_a_tilted_laser_is_said(driven, bag_path):
    # A quaternion has half of the angle: 0.2 rad are 11 degrees.
    rotation = (0.0, np.sin(0.1), 0.0, np.cos(0.1))
    tilted_link = laser_link(JACKAL.laser.pose, rotation=rotation)
    drive = replace(until(driven, 1.0), transforms=tilted_link)
    read_back_drive = through_a_bag(bag_path, drive)
    assert read_back_drive.drive.notes == ["tf tilts the laser by 11 degrees: it is taken as level"]


def test_another_laser_is_taken_if_tf_knows_its_place(driven, tmp_path):
    one_second = until(driven, 1.0)
    bag_path = in_frames(tmp_path / "a.bag", one_second, laser="rear_laser")
    with pytest.raises(BagError, match="jackal has front_laser: give .* or record /tf"):
        read_back(bag_path)

    rear_link = laser_link((-0.1, 0.0, 3.0), frame="rear_laser")
    with_link = replace(one_second, transforms=rear_link)
    bag_path = in_frames(tmp_path / "b.bag", with_link, laser="rear_laser")
    read_back_drive = read_back(bag_path)
    assert read_back_drive.laser_pose == pytest.approx((-0.1, 0.0, 3.0))


def test_the_base_is_placed_by_its_own_link_and_not_by_the_more_frequent_one_of_matched_poses():
    still = (0.0, 0.0, 0.0)
    rows = [(0.0, "odom", "base_link", still), (1.0, "odom", "base_link", still)]
    for time in (0.0, 0.4, 0.8):
        rows.append((time, "odom", "matched", still))
    tree = FrameTree(links(rows))
    for frame in ("odom", "matched"):
        assert tree.busiest(frame, "base_link").stamp.tolist() == [0.0, 1.0]
    assert tree.busiest("matched", "odom").stamp.tolist() == [0.0, 0.4, 0.8]
