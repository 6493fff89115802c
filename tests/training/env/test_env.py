"""Tests of episodes, reward and environment: the paper's MDP, Gymnasium's check, same seeds."""

import math
from dataclasses import replace
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest

import sim_bridge
from applr_ros1 import robots
from applr_ros1.common.angles import inverse, transform_point
from applr_ros1.drives.drive import Drive, Goal
from applr_ros1.drives.ending import ODOMETRY_ARRIVED, TOO_EARLY
from applr_ros1.policy.dimensionless import DimensionlessEncoding
from applr_ros1.policy.encoding import PaperEncoding
from applr_ros1.policy.parameter_space import SPACE
from applr_ros1.robots import JACKAL
from training.env.episode import Episode
from training.env.outcome import Leg, Outcome, nearest, outcome_of
from training.env.reward import Reward, failed
from worlds import Course, Mover, World
from worlds.occupancy import occupancy

NORTH = math.pi / 2
PERIOD = 2.0  # time between two decisions [s]
CYCLE_S = 0.05  # time between two commands [s]


class FakeMoveBase:
    """Planner stub that gives each command (v, w) for a second, and the last one forever.

    After `end` cycles it gives its `result`, and the robot stands.
    """

    goal = None
    map_topics = ()  # It has no static layer.

    def __init__(self, *commands, end=None, result=None, variant="ours"):
        self.commands = commands
        self.end = end
        self.result = result
        self.goals = []
        self.requests = []
        self.steps = []
        self.scans = []
        self.held = []
        self.parameters = {"applr": {"movers": False}}
        self.goal_tolerance = 0.25
        self.variant = variant
        diagonal = 0.1 * np.arange(40)
        self.global_plan = np.column_stack([diagonal, diagonal, np.zeros(40)])

    def reset(self, time, seed=None):
        self.steps.clear()

    def set_goal(self, goal, time):
        self.goals.append((goal, time))
        self.goal = goal

    def make_plan(self, start, goal, tolerance=0.0):
        return self.global_plan

    def configuration(self, server):
        return {}  # No requested value is in force.

    def reconfigure(self, server, values):
        self.requests.append((server, values))
        if "vx_samples" in values:
            return {**values, "vx_samples": 7}  # The server changes this value.
        return values

    def report_held(self, held):
        self.held.append(held)

    def step(self, time, pose, twist, scan, local_origin):
        self.steps.append((time, pose, twist))
        self.scans.append(scan)
        cycle_count = len(self.steps)
        command = None
        if self.goals:
            second = (cycle_count - 2) // 20
            v, w = self.commands[min(second, len(self.commands) - 1)]
            if self.end is not None and cycle_count > self.end:
                v = 0.0
            command = (v, w)
        result = None
        if self.end is not None and cycle_count == self.end + 1:
            result = self.result
        return SimpleNamespace(
            command=command,
            result=result,
            new_plan=cycle_count % 10 == 1,
        )


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


def trial(
    obstacle=None, v=1.0, end=None, result=None, world=None, variant="ours", limit=50, **options
):
    """Return the episode of a robot that drives at v [m/s], with a limit on its decisions."""
    planner = FakeMoveBase(
        (v, 0.0),
        end=end,
        result=result,
        variant=variant,
    )
    simulator = sim_bridge.make("kinematic", slip=0.0)
    episode = Episode(
        simulator,
        planner,
        period=PERIOD,
        time_limit=PERIOD * limit,
        **options,
    )
    episode.reset(world or straight(obstacle), 0)
    return episode


def drive(episode, theta=SPACE.theta0, most=60):
    """Drive to the end of an episode, and return the outcomes of all decisions."""
    outcomes = []
    while not episode.outcome.over and len(outcomes) < most:
        outcomes.append(episode.decide(theta))
    return outcomes


def test_a_course_takes_the_time_it_takes_to_a_control_cycle():
    episode = trial()

    first_outcome, second_outcome, last_outcome = drive(episode)

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
    assert len(episode.drive.truth) == round(cycle_count) + 1
    assert len(episode.drive.decisions) == 3
    with pytest.raises(RuntimeError, match="reset"):
        episode.decide(SPACE.theta0)


def test_each_course_of_an_episode_has_a_goal_of_its_own():
    episode = trial()
    (first_goal,) = episode.drive.goals
    episode.reset(straight(), 1)
    (second_goal,) = episode.drive.goals
    assert first_goal.id != second_goal.id


def test_a_planner_without_a_static_layer_also_drives_in_a_world_with_a_map():
    world = straight()
    *_, without_map = drive(trial(world=world))
    *_, with_map = drive(trial(world=replace(world, map=occupancy(world, 0.05))))
    assert with_map.success
    assert with_map.time_s == without_map.time_s


def test_the_goal_is_sent_once_in_odom_and_the_parameters_through_the_servers():
    episode = trial()
    drive(episode)
    move_base = episode.move_base
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
    assert np.array_equal(episode.outcome.theta, expected_theta)

    # The laser is mounted 0.055 m ahead of the robot's centre.
    _, robot_pose, _ = move_base.steps[1]
    assert robot_pose == pytest.approx((0.0, 0.0, NORTH), abs=0.01)
    assert move_base.scans[1].sensor_pose == pytest.approx((0.0, 0.055, NORTH), abs=0.01)

    context = episode.context()
    observation = PaperEncoding(JACKAL).observe(context)
    assert observation.shape == (729,)
    assert observation[720] == pytest.approx(context.phi / math.pi)


def test_the_local_goal_is_relative_to_the_robot():
    episode = trial()
    # Plan: north-east, robot: north.
    assert episode.context().phi == pytest.approx(-math.pi / 4, abs=0.02)

    # Without a plan, the local goal is the goal.
    episode.move_base.global_plan = np.zeros((0, 3))
    episode.decide(SPACE.theta0)
    assert episode.context().phi == pytest.approx(0.0, abs=0.05)


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
            {"obstacle": WALL, "end_on_collision": True},
            True,
            {"collided": True, "reason": "contact"},
        ),
    ],
)
def test_each_end_of_a_trial_is_recorded(options, fails, ends):
    outcomes = drive(trial(**options))
    last_outcome = outcomes[-1]
    for field_name, expected in ends.items():
        assert getattr(last_outcome, field_name) == expected, field_name
    assert failed(last_outcome) == fails
    assert last_outcome.decisions == len(outcomes)
    if "obstacle" in options:
        assert last_outcome.min_clearance_m < 0.2
    if "end_on_collision" in options:
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
    episode = trial(
        v=speed,
        limit=6,
        end=result_cycle,
        result=result,
    )
    to_odom = episode.simulator.to_odom

    def to_odom_with_an_error(pose):
        x, y, yaw = pose
        return to_odom((x - off, y, yaw))

    episode.simulator.to_odom = to_odom_with_an_error
    episode.reset(replace(world, course=course), 0)

    *_, last_outcome = drive(episode)

    assert last_outcome.reason == reason
    assert last_outcome.success == (reason == "finished")
    # The course ends as soon as the robot is within the tolerance.
    if last_outcome.success and off:
        arrival_time = (4.0 - tolerance) / speed
        assert last_outcome.time_s == pytest.approx(arrival_time, abs=0.4)


def test_a_laser_of_5_hz_scans_in_every_fourth_cycle():
    robot = robots.load("turtlebot3_burger")
    planner = FakeMoveBase((0.1, 0.0))
    simulator = sim_bridge.make("kinematic", robot=robot)
    episode = Episode(simulator, planner, robot, period=2.0)
    episode.reset(straight(), 0)

    episode.decide(episode.space.theta0)

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
    assert laser.pose_at((1.0, 2.0, turned_left)) == pytest.approx(expected)


def test_the_first_beam_of_a_turned_laser_is_seen_in_its_direction_from_the_robot():
    laser = JACKAL.laser.model_copy(update={"pose": (0.1, 0.0, 0.5)})
    robot = replace(JACKAL, laser=laser)
    episode = trial(robot=robot)
    _, first_angle, _ = episode.seen().scan
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
    simulator = sim_bridge.make("kinematic", slip=0.0)
    episode = Episode(simulator, planner, period=1.0)
    episode.reset(replace(world, course=course), 0)
    for golden_row in GOLDEN:
        outcome = episode.decide(SPACE.theta0)
        context = episode.context()
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
    *_, outcome = drive(free_course)
    assert outcome.success
    assert not any(free_course.move_base.held[1:])

    before_wall = trial(WALL, monitor=True, limit=3)
    *_, outcome = drive(before_wall)
    assert not outcome.collided
    assert before_wall.move_base.held[-1]


@pytest.mark.parametrize(
    ("variant", "escapes", "moves"),
    [("cpp-like", True, True), ("cpp-like", False, False), ("ours", True, False)],
)
def test_the_monitor_moves_the_robot_if_a_cpp_like_planner_finds_no_command(
    variant, escapes, moves
):
    """The planner `ours` makes its escape motions itself."""
    episode = trial(
        v=0.0,
        monitor=True,
        limit=2,
        variant=variant,
        escapes=escapes,
    )
    original_filter = episode.stack.monitor.filter

    def checked_filter(time, pose, twist, command, *ages, creeps):
        is_planners = command == (0.0, 0.0)
        assert creeps == is_planners, "only the planner's commands may creep"
        return original_filter(time, pose, twist, command, *ages, creeps=creeps)

    episode.stack.monitor.filter = checked_filter
    drive(episode)
    twists = episode.drive.truth.twist
    assert twists.any() == moves
    assert not twists[:40].any(), "the monitor waits two seconds for the planner"


def test_nearest_is_bounded_and_finite_for_any_scan():
    assert nearest(np.array([np.nan, 0.5, np.inf, 3.0], np.float32), 0.1) == pytest.approx(0.5)
    assert nearest(np.array([-np.inf, 0.5], np.float32), 0.1) == 0.1
    assert nearest(np.full(3, np.nan, np.float32), 0.1) == math.inf


# -- reward: the paper's section III-C -------------------------------------------------------------
STEP = Outcome(
    np.zeros(8),
    progress=0.9,
    progress_y=0.8,
    last_scan_min=0.4,
    decision_min=0.2,
    contact=True,
    seconds=2.0,
    decisions=3,
)
TERMS = ("time", "progress", "clearance", "collision")


def terms_of(reward, outcome, scale=1.0, pace=1.0, limit=50):
    """Return the terms of a reward by name, for a robot of some size and pace."""
    robot = SimpleNamespace(scale=scale, pace=pace)
    total, terms = reward(outcome, limit, PERIOD, robot)
    assert total == pytest.approx(sum(terms.values()))
    assert set(terms) == set(TERMS)
    return terms


def approx_terms(time, progress, clearance, collision):
    """Return terms for a comparison."""
    return pytest.approx(dict(zip(TERMS, (time, progress, clearance, collision))))


def test_the_reward_has_the_papers_terms():
    terms = terms_of(Reward(c_f=1.0, c_p=2.0, c_c=0.1), STEP)
    assert terms == approx_terms(time=-1.0, progress=1.8, clearance=-0.25, collision=0.0)

    everything = Reward(
        along_y=True,
        exact_time=True,
        lowest=True,
        c_collision=3.0,
    )
    terms = terms_of(everything, replace(STEP, seconds=0.5, success=True))
    assert terms == approx_terms(time=-0.25, progress=0.8, clearance=-0.25, collision=-3.0)

    at_the_goal = replace(STEP, success=True)
    assert terms_of(Reward(), at_the_goal)["time"] == 0.0, "R_f is 0 at the goal"
    with pytest.raises(ValueError, match="should be a finite number"):
        Reward(c_p=float("nan"))


# A laser whose range_min is 0 may report 0.
@pytest.mark.parametrize(("lowest", "clearance"), [(math.inf, -0.5), (0.1, -10.0), (0.0, -10.0)])
def test_distance_is_bounded_both_ways(lowest, clearance):
    outcome = replace(STEP, last_scan_min=lowest)
    assert terms_of(Reward(c_c=1.0), outcome)["clearance"] == pytest.approx(clearance)


def test_a_failure_pays_for_the_time_until_the_limit():
    late_failure = replace(STEP, flipped=True, decisions=45)
    early_failure = replace(STEP, flipped=True, decisions=3)
    assert terms_of(Reward(), late_failure)["time"] == -6.0
    # Of the 47 decisions left, only those within failure_seconds count.
    assert terms_of(Reward(), early_failure)["time"] == -1.0 - 20.0
    assert terms_of(Reward(failure_seconds=11.0), early_failure)["time"] == -1.0 - 5.5
    assert terms_of(Reward(), replace(STEP, timeout=True))["time"] == -1.0


def test_times_are_scaled_by_the_pace_of_the_robot():
    """For a robot four times slower, a course and a failure have the same relative cost."""
    everything = Reward(exact_time=True, c_c=0.1)
    terms = terms_of(everything, STEP, pace=4.0)
    assert terms == approx_terms(time=-0.25, progress=0.9, clearance=-0.0625, collision=0.0)

    small_robots_progress = terms_of(Reward(), STEP, scale=1.0)["progress"]
    large_robots_progress = terms_of(Reward(), STEP, scale=2.0)["progress"]
    assert small_robots_progress == 2.0 * large_robots_progress != 0.0

    fallen = replace(STEP, flipped=True, decisions=3)
    assert terms_of(Reward(), STEP, pace=4.0)["time"] == -0.25
    assert terms_of(Reward(failure_seconds=11.0), fallen, pace=4.0)["time"] == -0.25 - 5.5
    # Limited by the time left
    assert terms_of(Reward(), fallen, pace=4.0)["time"] == -0.25 - 47 / 4

    husky = DimensionlessEncoding(robots.load("husky"), 1.0)  # .68 m wide, 1 m/s
    _, terms = Reward(exact_time=True)(STEP, 50, PERIOD, husky)
    assert terms["time"] == pytest.approx(-1.0 / (0.68 / 0.53 * 2.0))


# -- the environment -------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def env():
    """Return an environment of two worlds with episodes of three decisions."""
    import training.env.env

    environment = gymnasium.make(
        training.env.ID,
        worlds="generated:0,generated:1",
        simulator="kinematic",
        time_limit=6.0,
    )
    yield environment
    environment.close()


def test_the_environment_made_by_name_passes_gymnasiums_check():
    from gymnasium.utils.env_checker import check_env

    environment_id = "training.env:applr_ros1/Navigation-v0"
    environment = gymnasium.make(environment_id, worlds="generated:7", time_limit=4.0)
    check_env(environment.unwrapped)
    environment.close()


def test_the_same_seed_gives_the_same_episode(env):
    def run(seed):
        """Return all numbers of an episode with random actions, and its last info."""
        rng = np.random.default_rng(0)
        observation, info = env.reset(seed=seed)
        numbers = [observation]
        truncated = False
        while not truncated:
            action = rng.uniform(-1, 1, 8).astype(np.float32)
            observation, reward, terminated, truncated, info = env.step(action)
            assert not terminated
            numbers += [observation, [reward]]
        return np.concatenate(numbers), info

    numbers, info = run(5)
    repeated, info_again = run(5)
    of_other_seed, _ = run(6)
    assert np.array_equal(repeated, numbers)
    assert info_again["world"] == info["world"]
    assert info["timeout"]
    assert info["decisions"] == 3
    assert not np.array_equal(of_other_seed, numbers)


def test_the_seed_or_an_option_chooses_the_world(env):
    drawn_worlds = set()
    for seed in range(12):
        _, info = env.reset(seed=seed)
        drawn_worlds.add(info["world"])
    assert drawn_worlds == {"generated:0", "generated:1"}

    for seed in range(6):
        _, info = env.reset(seed=seed, options={"world": 1})
        assert info["world"] == "generated:1"


def test_theta_in_the_observation_is_in_force_in_the_planner(env):
    env.reset(seed=0)
    action = np.array([0.3, -0.2, 0.13, 0.4, -0.9, 1.0, -1.0, 0.5], np.float32)

    observation, *_, info = env.step(action)

    encoding = PaperEncoding(JACKAL)
    theta = encoding.theta(action)
    assert np.allclose(info["theta"], theta)
    np.testing.assert_allclose(observation[721:], encoding.action(theta), atol=1e-6)

    configuration = env.unwrapped.episode.move_base.configuration("TrajectoryPlannerROS")
    max_vel_x, max_vel_theta, vx_samples, *_ = theta
    assert configuration["max_vel_x"] == pytest.approx(max_vel_x)
    assert configuration["min_vel_theta"] == pytest.approx(-max_vel_theta)
    assert configuration["vx_samples"] == vx_samples
    assert set(info["reward"]) == set(TERMS)


@pytest.mark.parametrize(("period", "limit"), [(2.0, 50), (0.5, 200)])
def test_the_decision_period_changes_the_steps_but_not_the_cost_of_a_second(period, limit):
    from training.env.env import ApplrEnv

    env = ApplrEnv(worlds="generated:0", period=period, reward={"exact_time": True})
    env.reset(seed=1)
    action = env.encoding.action(env.space.theta0)
    time_cost = 0.0
    time_s = 0.0
    terminated = False
    while not terminated:
        last_decision_s = time_s
        _, _, terminated, truncated, info = env.step(action)
        assert not truncated
        time_s = info["time_s"]
        time_cost += info["reward"]["time"]
        # The last step ends with the course.
        assert terminated or time_s - last_decision_s == pytest.approx(period)
    env.close()
    assert info["success"]
    assert env.episode.limit == limit
    # The paper's period is 2 s.
    assert time_cost == pytest.approx(-time_s / 2.0)
    assert info["decisions"] - 1 < time_s / period <= info["decisions"] + 1e-6


def test_the_decision_period_is_a_multiple_of_the_control_cycle():
    from training.env.env import ApplrEnv

    with pytest.raises(ValueError, match="multiple of 0.05"):
        ApplrEnv(worlds="generated:0", period=0.07)


@pytest.mark.parametrize("movers", [False, True])
def test_the_costmaps_get_predicted_obstacle_points_if_the_settings_request_them(movers):
    from training.env.env import ApplrEnv

    def predicted_points():
        """Return the number of points of all sources besides the laser."""
        (layer,) = env.episode.move_base.local_costmap.obstacle_layers
        _, *other_buffers = layer.buffers
        point_count = 0
        for buffer in other_buffers:
            for cloud in buffer.clouds:
                point_count += len(cloud.points)
        return point_count

    env = ApplrEnv("dynamic:401", period=1.0, movers=movers)
    for _ in range(2):
        env.reset(seed=0)
        assert predicted_points() == 0, "the tracker has no moving obstacle yet"
        for _ in range(3):
            env.step(np.zeros(env.action_space.shape, np.float32))
        assert (predicted_points() > 20) == movers
    env.close()


@pytest.mark.parametrize(("obstacle_range", "in_force"), [(None, 2.5), (5.0, 5.0)])
def test_an_environment_marks_obstacles_as_far_as_its_settings_say(obstacle_range, in_force):
    from training.env.env import ApplrEnv

    env = ApplrEnv("generated:7", period=1.0, obstacle_range=obstacle_range)
    move_base = env.episode.move_base
    for costmap in (move_base.global_costmap, move_base.local_costmap):
        (buffer,) = costmap.obstacles.buffers
        assert buffer.source.obstacle_range == in_force
    env.close()


def test_a_course_begins_without_a_scan_of_the_previous_course():
    env = gymnasium.make(
        "training.env:applr_ros1/Navigation-v0",
        worlds="generated:7",
        simulator="kinematic",
        observation="dimensionless",
        period=1.0,
    )
    env.reset(seed=0)
    on_its_way, *_ = env.step(np.zeros(env.action_space.shape, np.float32))
    at_begin, _ = env.reset(seed=1)
    # This encoding has the scan of the decision before, too, which at first is the same.
    beam_count = env.unwrapped.encoding.scan
    for observation, is_repeated in ((on_its_way, False), (at_begin, True)):
        scan, earlier_scan = np.split(observation[:beam_count], 2)
        assert np.array_equal(scan, earlier_scan) == is_repeated
    env.close()


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
    simulator = sim_bridge.make("kinematic", slip=0.0)
    planner = FakeMoveBase((0.0, 0.6))
    planner.parameters = {"applr": {"movers": True}}
    planner.sources = ("front/scan",)
    episode = Episode(simulator, planner, period=0.5)
    encoding = DimensionlessEncoding(JACKAL, 0.5)
    episode.layout = encoding.layout

    def seen_after_three_decisions(*movers):
        """Return x, y, vx, vy of three moving obstacles, as the observation has them."""
        episode.reset(replace(straight(), movers=movers), 0)
        drive(episode, most=3)
        observation = encoding.observe(episode.context())
        return observation[-12:].reshape(3, 4)

    nobody = [1.0, 0.0, 0.0, 0.0]
    assert seen_after_three_decisions().tolist() == [nobody, nobody, nobody]
    seen_walker, *others = seen_after_three_decisions(walker)
    for other in others:
        assert other.tolist() == nobody

    state = simulator.state
    _, _, yaw = state.pose
    assert yaw > 2.0
    x, y = transform_point(inverse(state.pose), *walker.position(state.time))
    vx, vy = transform_point((0.0, 0.0, -yaw), 1.25, 0.0)
    # The units of the encoding
    length = 15.0 * encoding.width
    speed = JACKAL.base.max_speed
    in_metres = seen_walker * (length, length, speed, speed)
    np.testing.assert_allclose(in_metres, (x, y, vx, vy), atol=0.2)
