"""Tests of what the replay reads from bags: plans, names, frames, poses and the laser's place from
tf.
"""

from dataclasses import replace

import numpy as np
import pytest

from applr_ros1.common.angles import compose, inverse, quaternion_of
from applr_ros1.drives.drive import Commands, Drive, Goal, Motion, Plans, Transforms
from applr_ros1.robots import JACKAL
from tests.support.drives import simulated, until
from training.bags.paths import path_of
from training.bags.read import BagError, read
from training.bags.topics import CHANNELS, Maker, TopicNames
from training.bags.transforms import Tree
from training.bags.write import BagWriter, write
from training.why.recorded import RecordedOptions, drive_of, followed_plans, plans_of
from training.why.replay import Replay


@pytest.fixture(scope="module")
def driven():
    """Return a drive of six seconds, with the plans of both planners."""
    drive = simulated(JACKAL, "generated:40", limit=6)[0]
    return replace(drive, frames={})


def read_back(path, **options):
    """Return the drive that the replay reads from a bag."""
    return drive_of(path, RecordedOptions(**options))


def through_a_bag(path, drive):
    """Return a drive as it is read from the bag that it is written to."""
    return read_back(write(path, drive))


def share(drive):
    """Return the share of the drive's commands that the replay reproduces."""
    replayed = Replay(JACKAL)
    replayed.run(drive)
    return replayed.share


def links(rows, is_static=False):
    """Return transforms from rows (time, parent, child, (x, y, yaw))."""
    stamps, parents, children, poses = zip(*rows)
    times = np.array(stamps, float)
    places = [(x, y, 0.0, *quaternion_of(yaw)) for x, y, yaw in poses]
    is_static = [is_static] * len(rows)
    return Transforms(times, times, list(parents), list(children), np.array(places), is_static)


def joined(*parts):
    """Return several transforms as one."""
    return Transforms(
        np.concatenate([part.time for part in parts]),
        np.concatenate([part.stamp for part in parts]),
        [frame for part in parts for frame in part.parent],
        [frame for part in parts for frame in part.child],
        np.concatenate([part.place for part in parts]),
        [flag for part in parts for flag in part.is_static],
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
def test_the_plan_comes_from_the_global_planner_where_the_local_planners_is_missing(
    driven, tmp_path
):
    with_routes_alone = through_a_bag(tmp_path / "navfn.bag", replace(driven, plans=None))
    assert with_routes_alone.planners == []
    assert share(with_routes_alone) > 0.97
    # A bag with both has the local planner's plan, not one that is rebuilt.
    with_both = through_a_bag(tmp_path / "both.bag", driven)
    assert np.allclose(with_both.plans.path[5], driven.plans.path[5])


def test_of_navfns_two_plans_of_one_stamp_the_second_is_followed(driven, tmp_path):
    """Navfn publishes each plan without the goal's pose first."""
    times = np.repeat(driven.routes.time, 2)
    published = []
    for bag_path in driven.routes.path:
        published += [bag_path[:-1], bag_path]
    bag_path = write(
        tmp_path / "twice.bag", replace(driven, plans=None, routes=Plans(times, published))
    )
    read_back_drive = read(bag_path)
    assert len(read_back_drive.routes) == len(driven.routes)
    assert np.allclose(read_back_drive.routes.path[3], driven.routes.path[3])


def test_a_plan_that_came_during_a_cycle_may_be_too_late_for_it(driven, tmp_path):
    """Each plan comes 5 ms before the command of the cycle before its own."""
    # Cycles are 50 ms apart, and the 5 ms are within the time that a cycle may take.
    early = Plans(driven.routes.time - 0.055, driven.routes.path)
    path = write(tmp_path / "early.bag", replace(driven, plans=None, routes=early))
    assert share(read_back(path)) > 0.97


def straight(seconds, metres):
    """Return a drive along x that follows one route from 0 to 10 m."""
    time = np.linspace(0.0, seconds, 21)
    pose = np.zeros((21, 3))
    pose[:, 0] = np.linspace(0.0, metres, 21)
    route = np.column_stack([np.linspace(0.0, 10.0, 401), np.zeros((401, 2))])
    twist = np.tile([0.5, 0.0], (21, 1))
    return Drive(
        odometry=Motion(time, time, pose, twist),
        planned=Commands(time, twist),
        routes=Plans(np.array([0.0]), [route]),
        frames={"routes": ["odom"]},
    )


def test_points_that_were_pruned_stay_away_when_the_robot_drives_back():
    drive = straight(10.0, 5.0)
    # The last pose lies 4.25 m behind the one before it, at 4.75 m.
    drive.odometry.pose[-1, 0] = 0.5
    plans = followed_plans(drive, Tree(None), JACKAL)
    assert plans.path[0][0, 0] == 0.0
    # move_base pruned up to 1 m behind the robot, and pruned points do not come back.
    assert plans.path[-1][0, 0] == pytest.approx(3.75, abs=0.3)


def test_empty_plans_alone_are_replaced_by_parts_of_the_global_planners(driven):
    drive = replace(until(driven, 2.0), frames={"routes": ["odom"]})
    assert plans_of(drive, Tree(None), JACKAL) is drive.plans
    empty = replace(drive.plans, path=[np.zeros((0, 3))] * len(drive.plans))
    plans = plans_of(replace(drive, plans=empty), Tree(None), JACKAL)
    assert len(plans)
    assert all(map(len, plans.path))
    assert plans_of(replace(drive, plans=empty, routes=None), Tree(None), JACKAL) is empty


def test_a_plan_in_another_frame_is_moved_by_tf_and_refused_without(driven):
    drive = straight(2.0, 0.5)
    drive.frames["routes"] = ["map"]
    with pytest.raises(Exception, match="the plan is in map, the odometry in odom: record /tf"):
        followed_plans(drive, Tree(None), JACKAL)
    origin = (3.0, 0.0, 0.6)  # pose of odom in map
    tree = Tree(links([(0.0, "map", "odom", origin)], is_static=True))
    plans = followed_plans(drive, tree, JACKAL)
    # A point of the route in map lies on the plan in odom, with its heading there.
    x, y, yaw = compose(inverse(origin), (4.0, 0.0, 0.0))
    plan = plans.path[0]
    distances = np.hypot(plan[:, 0] - x, plan[:, 1] - y)
    assert distances.min() < 1e-9
    assert plan[distances.argmin(), 2] == pytest.approx(yaw)


def test_commands_without_a_plan_or_after_the_goal_have_none():
    drive = straight(2.0, 1.0)
    drive.routes = Plans(np.array([0.5]), drive.routes.path)
    # The route comes after 0.5 s, and the goal is reached after 1.5 s of the 2 s.
    drive.goals = [Goal("g", 0.0, 1.5)]
    times = followed_plans(drive, Tree(None), JACKAL).time
    assert (times.min(), times.max()) == (pytest.approx(0.5), pytest.approx(1.5))


def test_a_path_read_at_once_equals_that_of_rosbags(driven, tmp_path, monkeypatch):
    path = write(tmp_path / "drive.bag", until(driven, 2.0))
    quick = read(path)
    # None stands for a path that cannot be read at once.
    monkeypatch.setattr("training.bags.paths.path_of", lambda raw: None)
    slow = read(path)
    for ours, theirs in zip(quick.plans.path, slow.plans.path, strict=True):
        # Both compute the yaw from a quaternion; only the order of the operations may differ.
        assert np.allclose(ours, theirs, rtol=0.0, atol=1e-15)


def serialised(frames, turns):
    """Return a path with poses of some frames and quaternions (n, 4): its message, and as bytes."""
    maker = Maker()
    poses = []
    for frame, turn in zip(frames, turns, strict=True):
        stamped = maker.stamped_pose(2.0, frame, (1.0, 2.0, 0.0))
        quaternion = maker.make("geometry_msgs/msg/Quaternion", *turn)
        pose = maker.make("geometry_msgs/msg/Pose", stamped.pose.position, quaternion)
        poses.append(maker.make("geometry_msgs/msg/PoseStamped", stamped.header, pose))
    message_type = "nav_msgs/msg/Path"
    message = maker.make(message_type, maker.header(2.0, "/map"), poses)
    return message, maker.store.serialize_ros1(message, message_type)


def test_a_path_read_at_once_has_the_yaws_of_rotations_that_are_not_level():
    turns = np.random.default_rng(0).normal(size=(9, 4))
    message, raw = serialised(["map"] * 9, turns)
    stamp, frame, poses = path_of(raw)
    assert (stamp, frame) == (2_000_000_000, "map")
    assert np.allclose(poses, CHANNELS["routes"].unpack(message)[2], rtol=0.0, atol=1e-15)


def test_poses_of_frames_of_unequal_lengths_are_left_to_rosbags():
    """Lengths of 3, 2 and 4 add up as three of 3 would."""
    _, raw = serialised(["map", "ab", "odom"], np.ones((3, 4)))
    assert path_of(raw) is None


def test_a_damaged_path_is_left_to_rosbags():
    # Nothing, a cut header, absurd lengths, and a header before poses that are not there.
    for raw in (b"", b"\0" * 12, b"\xff" * 40, b"\0" * 16 + b"\5\0\0\0" + b"\0" * 99):
        assert path_of(raw) is None
    # All zeros is a whole message: an empty path in a frame without a name.
    assert len(path_of(b"\0" * 20)[2]) == 0


# -- names -----------------------------------------------------------------------------------------
def names(**changed):
    """Return the Jackal's topics with some of them changed."""
    return replace(TopicNames.of(JACKAL), **changed)


def test_move_base_is_found_by_its_plans(driven, tmp_path):
    with_both = until(driven, 1.0)
    with_routes_alone = replace(with_both, plans=None)
    for number, namespace in enumerate(("/move_base_node", "/robot1/move_base")):
        topics = names(move_base=namespace)
        for kind, drive in (("both", with_both), ("routes", with_routes_alone)):
            path = write(tmp_path / f"{kind}{number}.bag", drive, topics=topics)
            # One second at 20 Hz.
            assert len(read_back(path).plans) > 10


def test_topics_in_the_namespace_around_move_base_are_found(driven, tmp_path):
    topics = names(
        move_base="/robot1/move_base",
        scan="/robot1/front/scan",
        odometry="/robot1/odometry/filtered",
        command="/robot1/cmd_vel",
    )
    assert len(read_back(write(tmp_path / "a.bag", until(driven, 1.0), topics=topics)).scans) > 3


def test_of_several_move_base_one_is_asked_for(driven, tmp_path):
    path = tmp_path / "two.bag"
    with BagWriter(path, JACKAL, names(move_base="/a/move_base")) as writer:
        writer.write(until(driven, 1.0))
        writer.topics = names(move_base="/b/move_base")
        writer.put("plans", 9.0, "odom", driven.plans.path[0], part="TrajectoryPlannerROS")
    with pytest.raises(
        BagError, match="plans of /a/move_base and of /b/move_base: give --move-base"
    ):
        read_back(path)
    assert len(read_back(path, move_base="/a/move_base").plans) > 10


@pytest.mark.parametrize(
    ("topics", "problem"),
    [
        (
            {"command": "/cmd_vel_mux/input/navi"},
            "/cmd_vel: give --command; the bag has Twists on /cmd_vel_mux/input/navi",
        ),
        ({"scan": "/scan"}, "/front/scan: give --scan; the bag has LaserScans on /scan"),
        (
            {"odometry": "/odom"},
            "/odometry/filtered: give --odometry; the bag has Odometry on /odom",
        ),
    ],
)
def test_a_missing_topic_is_named_with_its_option_and_the_bags_topics(
    driven, tmp_path, topics, problem
):
    drive = replace(until(driven, 1.0), planned=None)
    path = write(tmp_path / "a.bag", drive, topics=names(**topics))
    with pytest.raises(BagError, match=f"no messages on {problem}"):
        read_back(path)
    assert len(read_back(path, **topics).plans) > 10


def test_a_topic_of_another_type_is_not_read(driven, tmp_path):
    drive = replace(until(driven, 1.0), planned=None)
    # The topic of the commands has the name of the scan's; --command leads to the scan's Twists.
    path = write(tmp_path / "a.bag", drive, topics=names(command="/front/scan", scan="/scan"))
    with pytest.raises(BagError, match="/front/scan has messages of geometry_msgs/msg/Twist"):
        read_back(path, command="/front/scan")


def test_a_robot_that_was_given_is_not_asked_for(driven, tmp_path):
    path = write(tmp_path / "a.bag", replace(until(driven, 1.0), planners=["DWAPlannerROS"]))
    with pytest.raises(BagError, match="give the robot as --robot"):
        read_back(path)
    with pytest.raises(BagError, match="its base_local_planner is another"):
        read_back(path, robot=JACKAL)


# -- frames ----------------------------------------------------------------------------------------
def in_frames(path, drive, **frames):
    """Write a drive whose messages have the frames of robot.yaml, or others."""
    robot = JACKAL
    if "laser" in frames:
        laser = robot.laser.model_copy(update={"frame": frames["laser"]})
        robot = replace(robot, laser=laser)
    return write(path, replace(drive, frame=frames.get("odom", "odom")), robot=robot)


def test_a_plan_in_another_frame_than_the_odometry_is_refused(driven, tmp_path):
    with BagWriter(tmp_path / "a.bag", JACKAL, names()) as writer:
        writer.write(replace(until(driven, 1.0), plans=None, routes=None))
        writer.put("plans", 1.5, "map", driven.plans.path[0], part="TrajectoryPlannerROS")
    with pytest.raises(BagError) as refusal:
        read_back(tmp_path / "a.bag")
    problem = "the plan is in map, the odometry in odom: record /tf and /tf_static"
    assert str(refusal.value).endswith(problem)


def test_a_local_costmap_in_another_frame_than_the_odometry_is_placed_by_tf(driven, tmp_path):
    """The map lies a whole number of cells away, so that the costmap has the same cells."""
    odom_in_map = (-3.2, 1.6, 0.0)
    short = replace(until(driven, 3.0), routes=None)
    plans_in_map = [np.add(path, (*odom_in_map[:2], 0.0)) for path in short.plans.path]
    transforms = joined(
        robots_links(short.odometry),
        links([(0.0, "map", "odom", odom_in_map)], is_static=True),
    )
    with BagWriter(tmp_path / "a.bag", JACKAL, names()) as writer:
        writer.write(replace(short, plans=None, transforms=transforms))
        # The writer begins a bag at 1 s of ROS time.
        for time, path in zip(short.plans.time, plans_in_map, strict=True):
            first = short.odometry.time[0]
            writer.put("plans", 1.0 + time - first, "map", path, part="TrajectoryPlannerROS")
    read_back_drive = read_back(tmp_path / "a.bag")
    assert read_back_drive.frame == "map"
    assert np.allclose(read_back_drive.odometry.pose, short.odometry.pose + odom_in_map)
    assert np.allclose(read_back_drive.plans.path[3], plans_in_map[3])
    assert share(read_back_drive) > 0.9


def test_a_prefix_that_all_frames_share_is_taken_off(driven, tmp_path):
    short = until(driven, 1.0)
    transforms = robots_links(drifting(short.odometry), "robot1/odom", "robot1/base_link")
    drive = replace(short, transforms=transforms)
    bag_path = in_frames(tmp_path / "a.bag", drive, odom="robot1/odom", laser="robot1/front_laser")
    read_back_drive = read_back(bag_path)
    assert np.allclose(read_back_drive.odometry.pose, drifting(short.odometry).pose)
    # A prefix of the scans alone is no prefix of the robot: it may be another robot's laser.
    bag_path = in_frames(tmp_path / "b.bag", drive, laser="robot1/front_laser")
    with pytest.raises(BagError, match="scans in robot1/front_laser, jackal has front_laser"):
        read_back(bag_path)


# -- poses -----------------------------------------------------------------------------------------
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
    (note,) = with_tf.notes
    assert note.startswith("the odometry topic is not what tf shows: up to 0.")


def test_tf_that_equals_the_topic_changes_nothing(driven, tmp_path):
    without_tf = through_a_bag(tmp_path / "a.bag", driven)
    drive = replace(driven, transforms=robots_links(driven.odometry))
    with_tf = through_a_bag(tmp_path / "b.bag", drive)
    assert with_tf.notes == []
    assert np.allclose(with_tf.odometry.pose, without_tf.odometry.pose, rtol=0.0, atol=1e-12)
    assert np.array_equal(with_tf.odometry.twist, without_tf.odometry.twist)


def test_poses_are_composed_along_a_chain_of_links(driven, tmp_path):
    """odom -> base_footprint moves, base_footprint -> base_link is static."""
    offset = (0.1, -0.2, 0.3)
    footprint_poses = []
    for base_pose in driven.odometry.pose.tolist():
        footprint_poses.append(compose(tuple(base_pose), inverse(offset)))
    of_footprint = replace(driven.odometry, pose=np.array(footprint_poses))
    chain = joined(
        links([(0.0, "base_footprint", "base_link", offset)], is_static=True),
        robots_links(of_footprint, child="base_footprint"),
    )
    read_back_drive = through_a_bag(tmp_path / "a.bag", replace(driven, transforms=chain))
    assert np.allclose(read_back_drive.odometry.pose, driven.odometry.pose)


def test_a_quaternion_and_its_opposite_are_one_rotation():
    transforms = links(
        [(0.0, "odom", "base_link", (0, 0, 0.2)), (1.0, "odom", "base_link", (0, 0, 0.4))]
    )
    # Averaged as they are, both would cancel: the yaw in between would be noise.
    transforms.place[1, 3:] *= -1.0
    between = Tree(transforms).place("odom", "base_link", np.array([0.5]))
    assert between.planar[0, 2] == pytest.approx(0.3)


def test_a_frame_is_placed_in_one_of_another_branch():
    """As a laser on the body, beside a base frame that is on the body as well."""
    base = (2.0, -1.0, 0.5)
    laser = (0.5, 1.0, -2.0)
    tree = Tree(links([(0.0, "body", "base", base), (0.0, "body", "laser", laser)], is_static=True))
    between = tree.place("base", "laser", np.zeros(1))
    assert between.planar[0] == pytest.approx(compose(inverse(base), laser))


def test_more_frequent_poses_of_tf_are_all_taken(driven, tmp_path):
    short = until(driven, 2.0)
    every_second = short.odometry.part(slice(0, None, 2))
    drive = replace(short, odometry=every_second, transforms=robots_links(short.odometry))
    read_back_drive = through_a_bag(tmp_path / "a.bag", drive)
    assert np.allclose(read_back_drive.odometry.pose, short.odometry.pose)
    assert np.allclose(read_back_drive.odometry.twist[::2], every_second.twist)


def test_frames_in_a_circle_and_rotations_of_no_length_are_no_pose(driven, tmp_path):
    circle = joined(
        links([(0.0, "b", "base_link", (0, 0, 0))]), links([(0.0, "base_link", "b", (0, 0, 0))])
    )
    short = until(driven, 1.0)
    read_back_drive = through_a_bag(tmp_path / "a.bag", replace(short, transforms=circle))
    assert np.allclose(read_back_drive.odometry.pose, short.odometry.pose)

    # These would move the robot, if they were taken.
    without_length = robots_links(drifting(short.odometry))
    without_length.place[:, 3:] = 0.0
    drive = replace(short, transforms=without_length)
    read_back_drive = through_a_bag(tmp_path / "b.bag", drive)
    assert np.allclose(read_back_drive.odometry.pose, short.odometry.pose)


# -- laser -----------------------------------------------------------------------------------------
def test_the_lasers_place_is_tfs(driven, tmp_path):
    short = until(driven, 1.0)
    as_in_robot_yaml = replace(short, transforms=laser_link(JACKAL.laser.pose))
    unmoved = through_a_bag(tmp_path / "a.bag", as_in_robot_yaml)
    assert (unmoved.laser_pose, unmoved.notes) == (None, [])

    elsewhere = (0.2, 0.1, 0.5)
    drive = replace(short, transforms=laser_link(elsewhere))
    moved = through_a_bag(tmp_path / "b.bag", drive)
    assert moved.laser_pose == pytest.approx(elsewhere)
    (note,) = moved.notes
    assert note.startswith("tf has the laser at (0.20, 0.10) m, 0.50 rad, robot.yaml at (0.06")

    # The replay's costmaps get the scan from there. The robot moves a little until its first scan.
    replay = Replay(JACKAL)
    replay.drive = moved
    x, y, yaw = compose(tuple(moved.odometry.pose[0]), elsewhere)
    assert replay.scan(0).sensor_pose == pytest.approx((x, y, yaw), abs=0.02)


def test_a_laser_upside_down_has_its_beams_in_reverse(driven, tmp_path):
    """Rotated by pi about x, beam k of n points as beam n - 1 - k of an upright laser."""
    short = until(driven, 2.0)
    # A symmetric fan would be the same in reverse.
    short.scans = replace(short.scans, fan=short.scans.fan + [0.3, 0.0, 0.0, 0.0])
    reversed_scans = [ranges[::-1].copy() for ranges in short.scans.ranges]
    # The fan begins where the upright one ends, on the other side.
    fan = short.scans.fan.copy()
    steps = len(reversed_scans[0]) - 1
    last_angles = fan[:, 0] + steps * fan[:, 1]
    fan[:, 0] = -last_angles
    drive = replace(
        short,
        scans=replace(short.scans, fan=fan, ranges=reversed_scans),
        transforms=laser_link(JACKAL.laser.pose, rotation=(1.0, 0.0, 0.0, 0.0)),
    )
    read_back_drive = through_a_bag(tmp_path / "a.bag", drive)
    assert read_back_drive.notes == [
        "the laser is mounted upside down (tf): its beams are taken in reverse"
    ]
    assert np.array_equal(read_back_drive.scans.ranges[3], short.scans.ranges[3])
    assert np.allclose(read_back_drive.scans.fan, short.scans.fan, atol=1e-6)


def test_a_tilted_laser_is_said(driven, tmp_path):
    tilted = (0.0, np.sin(0.1), 0.0, np.cos(0.1))  # by .2 rad
    drive = replace(until(driven, 1.0), transforms=laser_link(JACKAL.laser.pose, rotation=tilted))
    read_back_drive = through_a_bag(tmp_path / "a.bag", drive)
    assert read_back_drive.notes == ["tf tilts the laser by 11 degrees: it is taken as level"]


def test_another_laser_is_taken_if_tf_knows_its_place(driven, tmp_path):
    short = until(driven, 1.0)
    bag_path = in_frames(tmp_path / "a.bag", short, laser="rear_laser")
    with pytest.raises(BagError, match="give the robot as --robot"):
        read_back(bag_path)
    with pytest.raises(BagError, match="jackal has front_laser: give --scan, or record /tf"):
        read_back(bag_path, robot=JACKAL)
    known = replace(short, transforms=laser_link((-0.1, 0.0, 3.0), frame="rear_laser"))
    read_back_drive = read_back(in_frames(tmp_path / "b.bag", known, laser="rear_laser"))
    assert read_back_drive.laser_pose == pytest.approx((-0.1, 0.0, 3.0))
