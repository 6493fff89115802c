"""Tests of drives in simulation: what a robot does and sees along a course, and how it ends.

In most tests the planner is a stub; the stack around it, the rules and the outcome are real.
"""

import math
from dataclasses import replace

import numpy as np
import pytest

import sim_bridge
import worlds
from applr_ros1 import robots
from applr_ros1.common.angles import inverse, transform_point
from applr_ros1.drives import simulate
from applr_ros1.drives.drive import KIND_OF_COLUMN, TIMED_OUT, Drive, Goal, Rows
from applr_ros1.drives.end_reasons import ODOMETRY_ARRIVED, TOO_EARLY
from applr_ros1.drives.end_rules import Rules
from applr_ros1.drives.outcome import Leg, nearest, outcome_of
from applr_ros1.drives.recorder import UNKNOWN
from applr_ros1.drives.simulate import CourseDrive
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.policy import methods
from applr_ros1.policy.decision import Context
from applr_ros1.policy.dimensionless import DimensionlessEncoding
from applr_ros1.policy.encoding import PaperEncoding
from applr_ros1.policy.observation import layout_of
from applr_ros1.policy.parameter_space import SPACE, space_of
from applr_ros1.policy.pilot import Pilot
from applr_ros1.robots import JACKAL
from applr_ros1.stack.simulated import SimulatedRobot
from applr_ros1.stack.stack import Stack
from tests.support.robots import FakeMoveBase, Script
from training.env.reward import failed
from worlds import Course, Mover, World
from worlds.occupancy import occupancy

NORTH = math.pi / 2
PERIOD = 2.0  # time between two decisions [s]
CYCLE_S = 0.05  # time between two commands [s]


def straight(obstacle=None):
    """Return a world with a course of 4 m to the north."""
    cylinders = np.array(obstacle or [], dtype=float).reshape(-1, 3)
    course = Course(
        start=(1.0, 2.0, NORTH),
        goal=(1.0, 10.0, NORTH),
        finish_y=6.0,
        goal_tolerance=0.4,
        path=np.array([(1.0, 2.0), (1.0, 6.0)]),
    )
    return World(
        "straight",
        cylinders,
        boxes=np.zeros((0, 5)),
        course=course,
    )


def simulated_robot(planner, robot=JACKAL, monitor=False, escapes=True):
    """Return a robot with a planner stub, whose wheels do not slip."""
    stack = Stack(robot, planner, monitor=monitor, escapes=escapes)
    return SimulatedRobot(sim_bridge.make("kinematic", robot=robot, slip=0.0), stack)


def trial(
    obstacle=None,
    v=1.0,
    end=None,
    result=None,
    world=None,
    variant="ours",
    limit=50,
    monitor=False,
    escapes=True,
    **rules,
):
    """Return the drive of a robot that drives at v [m/s], with a limit on its decisions."""
    planner = FakeMoveBase(
        (v, 0.0),
        end=end,
        result=result,
        variant=variant,
    )
    simulated = simulated_robot(planner, monitor=monitor, escapes=escapes)
    return begun(simulated, world or straight(obstacle), Rules(limit=PERIOD * limit, **rules))


def begun(simulated, world, rules=Rules(), period=PERIOD):
    """Return a drive at its begin, with the default parameters."""
    theta = space_of(simulated.robot).theta0
    return CourseDrive(simulated, world, 0, rules, period=period, theta=theta)


def decided(course_drive, theta=SPACE.theta0):
    """Return the outcome after a decision."""
    course_drive.decide(theta)
    course_drive.advance()
    return course_drive.outcome


def driven(course_drive, most=60):
    """Drive to the end of a course, and return the outcomes of all decisions."""
    outcomes = []
    while not course_drive.has_ended and len(outcomes) < most:
        outcomes.append(decided(course_drive))
    return outcomes


def context_of(course_drive, layout=None):
    """Return the context of the next decision."""
    robot = course_drive.simulated.robot
    layout = layout or layout_of(robot)
    return Context.of(course_drive.theta, course_drive.seen, space_of(robot), layout)


def test_a_course_takes_the_time_it_takes_to_a_control_cycle():
    course_drive = trial()

    first_outcome, second_outcome, last_outcome = driven(course_drive)

    assert last_outcome.success
    assert not failed(last_outcome)
    assert not last_outcome.timeout

    # 4 m at 1 m/s, and some acceleration at the start.
    assert last_outcome.time_s == pytest.approx(4.1, abs=0.15)
    cycle_count = last_outcome.time_s / CYCLE_S
    assert cycle_count == pytest.approx(round(cycle_count), abs=1e-6)
    assert last_outcome.decisions == 3
    assert first_outcome.seconds == pytest.approx(PERIOD)
    assert second_outcome.seconds == pytest.approx(PERIOD)
    assert last_outcome.seconds == pytest.approx(last_outcome.time_s - 2 * PERIOD)
    assert last_outcome.path_length_m == pytest.approx(4.0, abs=0.1)
    progress = first_outcome.progress + second_outcome.progress + last_outcome.progress
    progress_y = first_outcome.progress_y + second_outcome.progress_y + last_outcome.progress_y
    assert progress == pytest.approx(4.0, abs=0.1)
    assert progress_y == pytest.approx(4.0, abs=0.1)

    # The recording has the pose at the start, too.
    assert len(course_drive.drive.truth) == round(cycle_count) + 1
    assert len(course_drive.drive.decisions) == 3
    with pytest.raises(RuntimeError, match="the course has ended"):
        course_drive.decide(SPACE.theta0)
    with pytest.raises(RuntimeError, match="the course has ended"):
        course_drive.advance()


def test_each_course_has_a_goal_of_its_own():
    course_drive = trial()
    (first_goal,) = course_drive.drive.goals
    (second_goal,) = begun(course_drive.simulated, straight()).drive.goals
    assert first_goal.id != second_goal.id


def test_a_planner_without_a_static_layer_also_drives_in_a_world_with_a_map():
    world = straight()
    *_, without_map = driven(trial(world=world))
    *_, with_map = driven(trial(world=replace(world, map=occupancy(world, 0.05))))
    assert with_map.success
    assert with_map.time_s == without_map.time_s


def test_the_goal_is_sent_once_in_odom_and_the_parameters_through_the_servers():
    course_drive = trial()
    driven(course_drive)
    move_base = course_drive.simulated.stack.move_base
    ((goal, _),) = move_base.goals
    assert goal == pytest.approx((0.0, 8.0, NORTH))

    requests = dict(move_base.requests)
    assert set(requests) == set(SPACE.servers)
    planner_values = requests["TrajectoryPlannerROS"]
    assert planner_values["max_vel_theta"] == 1.57
    assert planner_values["min_vel_theta"] == -1.57
    assert planner_values["vx_samples"] == 6

    # The outcome has the value in force in the planner, and else what was requested.
    samples_index = SPACE.names.index("vx_samples")
    expected_theta = SPACE.theta0.copy()
    expected_theta[samples_index] = 7
    assert np.array_equal(course_drive.theta, expected_theta)

    # The laser is mounted 0.055 m ahead of the robot's centre.
    _, robot_pose, _ = move_base.steps[1]
    assert robot_pose == pytest.approx((0.0, 0.0, NORTH), abs=0.01)
    assert move_base.scans[1].sensor_pose == pytest.approx((0.0, 0.055, NORTH), abs=0.01)

    context = context_of(course_drive)
    observation = PaperEncoding(JACKAL).observe(context)
    assert observation.shape == (729,)
    assert observation[720] == pytest.approx(context.phi / math.pi)


def test_the_local_goal_is_relative_to_the_robot():
    course_drive = trial()
    # Plan: north-east, robot: north.
    assert context_of(course_drive).phi == pytest.approx(-math.pi / 4, abs=0.02)

    # Without a plan, the local goal is the goal.
    course_drive.simulated.stack.move_base.global_plan = np.zeros((0, 3))
    decided(course_drive)
    assert context_of(course_drive).phi == pytest.approx(0.0, abs=0.05)


WALL = (1.0, 4.0, 0.2)
REACHED = ("succeeded", "Goal reached.")
GIVES_UP = ("aborted", "why")
STALLS = {"v": 0.0, "limit": 6, "end_on_stall": True}
GIVEN_UP = {
    "aborted": True,
    "timeout": True,
    "over": True,
    "success": False,
    "time_s": 100.0,
    "decisions": 2,
}


@pytest.mark.parametrize(
    ("options", "fails", "ends"),
    [  # After a result away from the goal, also "succeeded", the robot would stand until the limit.
        (
            {"end": 50, "result": ("aborted", "why")},
            True,
            {**GIVEN_UP, "reason": "move_base gave up: why"},
        ),
        (
            {"end": 50, "result": ("succeeded", "why")},
            True,
            {**GIVEN_UP, "reason": TOO_EARLY},
        ),
        # The time limit is not a final failure.
        (
            {"v": 0.0, "limit": 5},
            False,
            {
                "decisions": 5,
                "time_s": 10.0,
                "timeout": True,
                "aborted": False,
            },
        ),
        # A stall is a failure if requested. The threshold of 0.85 m in 8 s is 0.106 m/s.
        ({"v": 0.0, "limit": 6}, False, {"decisions": 6}),
        (STALLS, True, {"decisions": 4, "reason": "stalled", "timeout": False}),
        ({**STALLS, "v": 0.10}, True, {"decisions": 4, "reason": "stalled", "timeout": False}),
        ({**STALLS, "v": 0.12}, False, {"decisions": 6, "reason": "time limit", "timeout": True}),
        (
            {**STALLS, "end": 160, "result": GIVES_UP},
            True,
            {"decisions": 4, "reason": "move_base gave up: why"},
        ),
        # Contacts are recorded, and end a trial if the protocol requires it.
        (
            {"obstacle": WALL, "limit": 4},
            False,
            {"collided": True, "timeout": True, "success": False},
        ),
        (
            {"obstacle": WALL, "end_on_contact": True},
            True,
            {"collided": True, "reason": "contact"},
        ),
    ],
)
def test_each_end_of_a_trial_is_recorded(options, fails, ends):
    outcomes = driven(trial(**options))
    last_outcome = outcomes[-1]
    for field_name, expected in ends.items():
        assert getattr(last_outcome, field_name) == expected, field_name
    assert failed(last_outcome) == fails
    assert last_outcome.decisions == len(outcomes)
    if "obstacle" in options:
        assert last_outcome.min_clearance_m < 0.2
    if "end_on_contact" in options:
        assert last_outcome.time_s < 4


@pytest.mark.parametrize(
    ("planner_ends", "off", "remaining", "result", "reason"),
    [
        (True, 0.4, 0.0, None, "finished"),
        (False, 0.4, 0.0, None, "time limit"),  # Only the circle around the course's goal counts.
        (True, 0.9, 0.0, None, "time limit"),  # The error of the odometry is too large.
        (True, 0.0, 0.6, REACHED, "finished"),
        (True, 0.0, 0.9, REACHED, TOO_EARLY),
        # By its odometry, the robot is at the goal.
        (True, 0.9, 0.0, REACHED, ODOMETRY_ARRIVED),
        (True, 0.0, 0.6, GIVES_UP, "move_base gave up: why"),
    ],
)
def test_a_course_without_a_finish_line_ends_when_the_planner_has_arrived(
    planner_ends, off, remaining, result, reason
):
    """The planner arrives by odometry with a lateral error `off` [m], or reports a result at
    `remaining` [m] before the goal.

    The robot drives at 0.5 m/s over its goal, 4 m ahead, and on beyond it.
    """
    tolerance = 0.25  # as FakeMoveBase.goal_tolerance [m]
    speed = 0.5
    world = straight()
    course = replace(
        world.course,
        goal=(1.0 + off, 6.0, NORTH),
        finish_y=None,
        goal_tolerance=tolerance,
        planner_ends=planner_ends,
    )
    result_cycle = None
    if result:
        result_cycle = round((4.0 - remaining) / speed / CYCLE_S)
    simulated = simulated_robot(FakeMoveBase((speed, 0.0), end=result_cycle, result=result))
    to_odom = simulated.simulator.to_odom

    def to_odom_with_an_error(pose):
        x, y, yaw = pose
        return to_odom((x - off, y, yaw))

    simulated.simulator.to_odom = to_odom_with_an_error
    course_drive = begun(simulated, replace(world, course=course), Rules(limit=6 * PERIOD))

    *_, last_outcome = driven(course_drive)

    assert last_outcome.reason == reason
    assert last_outcome.success == (reason == "finished")
    # The course ends as soon as the robot is within the tolerance.
    if last_outcome.success and off:
        arrival_time = (4.0 - tolerance) / speed
        assert last_outcome.time_s == pytest.approx(arrival_time, abs=0.4)


def test_a_laser_of_5_hz_scans_in_every_fourth_cycle():
    robot = robots.load("turtlebot3_burger")
    planner = FakeMoveBase((0.1, 0.0))
    course_drive = begun(simulated_robot(planner, robot), straight())

    decided(course_drive, space_of(robot).theta0)

    # One at the reset, and 40 cycles in two seconds.
    assert len(planner.scans) == 41
    for cycle, scan in enumerate(planner.scans):
        assert (scan is not None) == (cycle % 4 == 0), cycle


# Columns of GOLDEN
FIELDS = (
    "phi",
    "progress",
    "progress_y",
    "last_scan_min",
    "decision_min",
    "contact",
    "collided",
    "seconds",
    "time_s",
    "path_length_m",
    "min_clearance_m",
    "mean_clearance_m",
    "mean_jerk",
    "mean_turn",
    "mean_range",
)
# A contact lasts into the decision in which the robot backs off. The clearance of a decision is the
# least of its scans, and that of a drive the least so far.
GOLDEN = (
    (-1.48, 0.73, 0.82, 0.51, 0.45, 0, 0, 1, 1, 0.82, 0.45, 0.54, 9.74, 0.44, 4.50),
    (-2.86, 1.15, 1.30, 0.15, 0.15, 1, 1, 1, 2, 2.13, 0.15, 0.55, 34.91, 2.47, 3.77),
    (-2.64, -0.33, -0.57, 0.79, 0.15, 1, 1, 1, 3, 2.79, 0.15, 0.50, 26.71, 2.40, 4.51),
    (2.99, -0.24, -0.32, 1.13, 0.79, 0, 1, 1, 4, 3.13, 0.15, 0.60, 22.29, 2.39, 4.75),
)


def test_the_pose_of_a_laser_that_is_mounted_aside_and_turned():
    laser = JACKAL.laser.model_copy(update={"pose": (0.1, 0.2, 0.5)})
    turned_left = 0.5 * math.pi
    expected = (1.0 - 0.2, 2.0 + 0.1, turned_left + 0.5)
    assert laser.pose_for((1.0, 2.0, turned_left)) == pytest.approx(expected)


def test_the_first_beam_of_a_turned_laser_is_seen_in_its_direction_from_the_robot():
    laser = JACKAL.laser.model_copy(update={"pose": (0.1, 0.0, 0.5)})
    robot = replace(JACKAL, laser=laser)
    simulated = simulated_robot(FakeMoveBase((1.0, 0.0)), robot)
    _, first_angle, _ = begun(simulated, straight()).seen.scan
    assert first_angle == pytest.approx(laser.first_angle + 0.5)


@pytest.mark.parametrize(("contact", "counts"), [(2.0, False), (2.05, True)])
def test_a_contact_at_the_very_beginning_belongs_to_the_course_before(contact, counts):
    drive = Drive(contacts=np.array([contact]))
    goal = Goal("g", begin=2.0, end=4.0, status="reached")
    leg = Leg(
        begin=2.0,
        end=4.0,
        goal=(2.0, 0.0, 0.0),
        start_place=(0.0, 0.0),
        end_place=(2.0, 0.0),
    )
    outcome = outcome_of(
        drive,
        goal,
        leg,
        SPACE.theta0,
        1,
        body_width=0.4,
    )
    assert outcome.collided is counts
    assert outcome.contact is counts


def test_outcome_of_each_decision_of_a_drive():
    """In one decision each, the robot passes a post, touches another, backs off, and turns.

    The goal is to the left.
    """
    world = straight([(1.55, 2.6, 0.1), (1.1, 4.5, 0.2)])
    course = replace(world.course, goal=(-3.0, 10.0, NORTH))
    planner = FakeMoveBase(
        (1.0, 0.0),
        (1.5, 0.0),
        (-0.8, 0.0),
        (-0.3, 0.8),
    )
    course_drive = begun(simulated_robot(planner), replace(world, course=course), period=1.0)
    for golden_row in GOLDEN:
        outcome = decided(course_drive)
        context = context_of(course_drive)
        values = {
            **vars(outcome),
            "phi": context.phi,
            "mean_range": np.minimum(context.ranges, 5.0).mean(),
        }
        for field_name, expected in zip(FIELDS, golden_row):
            # GOLDEN has two places.
            assert float(values[field_name]) == pytest.approx(expected, abs=6e-3), field_name


def test_the_monitor_gets_the_scans_and_the_planner_is_informed_of_blocked_commands():
    """The monitor does not affect a free course. Before a wall it stops the robot."""
    free_course = trial(monitor=True)
    *_, outcome = driven(free_course)
    assert outcome.success
    assert not any(free_course.simulated.stack.move_base.held[1:])

    before_wall = trial(WALL, monitor=True, limit=3)
    *_, outcome = driven(before_wall)
    assert not outcome.collided
    assert before_wall.simulated.stack.move_base.held[-1]


@pytest.mark.parametrize(
    ("variant", "escapes", "moves"),
    [("cpp-like", True, True), ("cpp-like", False, False), ("ours", True, False)],
)
def test_the_monitor_moves_the_robot_if_a_cpp_like_planner_finds_no_command(
    variant, escapes, moves
):
    """The planner `ours` makes its escape motions itself."""
    course_drive = trial(
        v=0.0,
        monitor=True,
        limit=2,
        variant=variant,
        escapes=escapes,
    )
    monitor = course_drive.simulated.stack.monitor
    original_filter = monitor.filter

    def checked_filter(time, pose, twist, command, *ages, creeps):
        is_planners = command == (0.0, 0.0)
        assert creeps == is_planners, "only the planner's commands may creep"
        return original_filter(time, pose, twist, command, *ages, creeps=creeps)

    monitor.filter = checked_filter
    driven(course_drive)
    twists = course_drive.drive.truth.twist
    assert twists.any() == moves
    assert not twists[:40].any(), "the monitor waits two seconds for the planner"


@pytest.mark.parametrize("variant", ["ours", "cpp-like"])
def test_the_monitor_brakes_the_base_while_the_planner_is_silent(variant):
    """As its node does: not before the planner could have sent its next command."""
    planner = FakeMoveBase((1.0, 0.0), None, variant=variant)
    simulated = simulated_robot(planner, monitor=True)
    course_drive = begun(simulated, straight(), period=1.0)
    decided(course_drive)
    monitor = simulated.stack.monitor
    silence_cycles = round(monitor.silence / CYCLE_S)
    sent_speeds = []
    simulator_command = simulated.simulator.command

    def recorded_command(v, w):
        sent_speeds.append(v)
        simulator_command(v, w)

    simulated.simulator.command = recorded_command
    cycles_before = len(planner.steps)
    decided(course_drive)

    # The first silent cycles send nothing, and the base keeps the planner's last command.
    assert silence_cycles >= 2
    assert len(sent_speeds) == len(planner.steps) - cycles_before - (silence_cycles - 1)
    # Then it is braked within its friction limit, and stands.
    falls = -np.diff([1.0, *sent_speeds])
    assert sent_speeds[0] < 1.0
    assert max(falls[1:]) <= 1.01 * monitor.settings.deceleration * CYCLE_S
    assert sent_speeds[-1] == 0.0
    assert course_drive.drive.truth.twist[-1, 0] == pytest.approx(0.0, abs=0.01)


def test_without_a_monitor_the_base_keeps_a_silent_planners_last_command():
    planner = FakeMoveBase((1.0, 0.0), None)
    simulated = simulated_robot(planner)
    course_drive = begun(simulated, straight(), period=1.0)
    decided(course_drive)
    simulated.simulator.command = lambda v, w: pytest.fail("nobody commands")
    decided(course_drive)


def test_an_escape_motion_also_replaces_the_silence_of_a_cpp_like_planner():
    planner = FakeMoveBase((0.0, 0.0), None, variant="cpp-like")
    course_drive = begun(simulated_robot(planner, monitor=True), straight(), period=1.0)
    for _ in range(3):
        decided(course_drive)
    twists = course_drive.drive.truth.twist
    assert not twists[:40].any(), "the monitor waits two seconds for the planner"
    assert twists[40:].any()


def test_nearest_is_bounded_and_finite_for_any_scan():
    assert nearest(np.array([np.nan, 0.5, np.inf, 3.0], np.float32), 0.1) == pytest.approx(0.5)
    assert nearest(np.array([-np.inf, 0.5], np.float32), 0.1) == 0.1
    assert nearest(np.full(3, np.nan, np.float32), 0.1) == math.inf


def test_the_observation_has_moving_obstacles_relative_to_a_robot_that_turns():
    """The robot starts at (1, 2), the origin of its odometry, and turns by more than 2 rad."""
    # Across the course at 1.25 m/s
    walker = Mover(
        radius=0.25,
        waypoints=(
            (0.0, -1.5, 4.0),
            (4.0, 3.5, 4.0),
        ),
    )
    planner = FakeMoveBase((0.0, 0.6))
    planner.parameters = {"applr": {"movers": True}}
    planner.sources = ("front/scan",)
    simulated = simulated_robot(planner)
    encoding = DimensionlessEncoding(JACKAL, 0.5)

    def seen_after_three_decisions(*movers):
        """Return x, y, vx, vy of three moving obstacles, as the observation has them."""
        course_drive = begun(simulated, replace(straight(), movers=movers), period=0.5)
        driven(course_drive, most=3)
        observation = encoding.observe(context_of(course_drive, encoding.layout))
        return observation[-12:].reshape(3, 4)

    nobody = [1.0, 0.0, 0.0, 0.0]
    assert seen_after_three_decisions().tolist() == [nobody, nobody, nobody]
    seen_walker, *others = seen_after_three_decisions(walker)
    for other in others:
        assert other.tolist() == nobody

    state = simulated.state
    _, _, yaw = state.pose
    assert yaw > 2.0
    x, y = transform_point(inverse(state.pose), *walker.position(state.time))
    vx, vy = transform_point((0.0, 0.0, -yaw), 1.25, 0.0)
    # The units of the encoding
    length = 15.0 * encoding.width
    speed = JACKAL.base.max_speed
    in_metres = seen_walker * (length, length, speed, speed)
    np.testing.assert_allclose(in_metres, (x, y, vx, vy), atol=0.2)


# -- with the real planner, and with a script
def jackal(seed=0):
    """Return a simulated Jackal with its own planner."""
    stack = Stack(JACKAL, MoveBase(JACKAL.parameters(), seed=seed), monitor=False)
    return SimulatedRobot(sim_bridge.make("kinematic"), stack)


def short_drive(pilot, simulated=None, **options):
    """Return a drive of four seconds, with the rows of its true motion."""
    world = worlds.load("generated:60")
    simulated = simulated or jackal()
    drive = simulate.drive(simulated, world, 3, pilot, Rules(limit=4.0), **options)
    return drive, np.column_stack([drive.truth.time, drive.truth.pose, drive.truth.twist])


def test_a_drive_without_a_pilot_is_that_of_a_pilot_who_leaves_the_parameters():
    """The noise of its scans, too, does not depend on whether somebody decides."""
    fixed = methods.FixedParameters(SPACE.theta0, redraws_stalled=False)
    decided_drive, decided_motion = short_drive(Pilot(fixed, JACKAL, 1.0), record=True)
    drive, motion = short_drive(None, record=True)
    assert np.array_equal(motion, decided_motion)
    assert np.array_equal(drive.scans.ranges, decided_drive.scans.ranges)
    assert drive.decisions == []
    assert drive.ends == []
    assert len(decided_drive.decisions) == 4
    (end,) = decided_drive.ends
    assert end.time == pytest.approx(4.0)
    assert end.after == {}


def test_a_recorded_drive_has_rows_in_each_column_that_a_robot_without_a_monitor_has():
    drive, _ = short_drive(None, record=True)
    row_columns = {name for name, kind in KIND_OF_COLUMN.items() if issubclass(kind, Rows)}
    empty_columns = {name for name in row_columns if not getattr(drive, name)}
    # Changes are recorded by those who make them.
    assert empty_columns == {*UNKNOWN, "changes", "verdicts"}


def test_a_pilot_begins_each_drive_anew():
    pilot = Pilot(methods.RandomParameters(), JACKAL, 1.0)
    simulated = jackal()
    first_drive, first_motion = short_drive(pilot, simulated)
    assert first_drive.scans is None, "columns that nobody asked for take memory"
    second_drive, second_motion = short_drive(pilot, simulated)
    assert np.array_equal(first_motion, second_motion)
    first_sets = [decision.after for decision in first_drive.decisions]
    second_sets = [decision.after for decision in second_drive.decisions]
    assert first_sets == second_sets
    assert first_sets[0] != first_sets[1]


def test_a_decision_may_clear_the_costmaps_before_it_takes_effect(monkeypatch):
    simulated = jackal()
    clearings = []
    move_base = simulated.stack.move_base
    monkeypatch.setattr(move_base, "clear_costmaps", lambda: clearings.append(course_drive.seconds))
    course_drive = begun(simulated, worlds.load("generated:60"), period=1.0)
    # They stay unless a decision says so.
    for options in ({}, {"clears_costmaps": True}, {"clears_costmaps": False}):
        course_drive.decide(SPACE.theta0, **options)
        course_drive.advance()
    assert clearings == [pytest.approx(1.0)]
    assert [decision.cleared for decision in course_drive.drive.decisions] == [False, True, False]


def test_a_script_has_no_plan_and_its_drive_no_scan_for_a_decision():
    simulated = SimulatedRobot(sim_bridge.make("kinematic"), Script(command=None))
    drive, _ = short_drive(None, simulated, record=True)
    assert drive.observed is None
    assert drive.goals[-1].status == TIMED_OUT
    # A cycle before the goal is sent, and four seconds
    assert len(drive.scans) == len(drive.odometry) == 81
    assert len(drive.routes) == len(drive.commands) == 0
