"""Tests of the episode loop, the reward and the environment: the paper's MDP, Gymnasium's checker,
repeatability.
"""

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
from applr_ros1.policy.dimensionless import DimensionlessEncoding
from applr_ros1.policy.encoding import PaperEncoding
from applr_ros1.policy.parameter_space import SPACE
from training.env.episode import Episode
from training.env.outcome import Leg, Outcome, nearest, outcome_of
from training.env.reward import Reward, failed
from worlds import Course, Mover, World
from worlds.occupancy import occupancy


class FakeMoveBase:
    """Planner stub: gives each command (v, w) for a second, the last one forever, and `result`
    after `end` cycles.
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
        self.global_plan = np.array([(0.1 * i, 0.1 * i, 0.0) for i in range(40)])

    def reset(self, now, seed=None):
        self.steps.clear()

    def set_goal(self, goal, now):
        self.goals.append((goal, now))
        self.goal = goal

    def make_plan(self, start, goal, tolerance=0.0):
        return self.global_plan

    def configuration(self, server):
        return {}  # No requested value is in force.

    def reconfigure(self, server, values):
        self.requests.append((server, values))
        # The server changes this value.
        return {**values, "vx_samples": 7} if "vx_samples" in values else values

    def report_held(self, held):
        self.held.append(held)

    def step(self, now, pose, twist, scan, local_origin):
        self.steps.append((now, pose, twist))
        self.scans.append(scan)
        over = self.end is not None and len(self.steps) > self.end
        command = self.commands[min((len(self.steps) - 2) // 20, len(self.commands) - 1)]
        command = (0.0 if over else command[0], command[1]) if self.goals else None
        result = self.result if over and len(self.steps) == self.end + 1 else None
        return SimpleNamespace(command=command, result=result, new_plan=len(self.steps) % 10 == 1)


def straight(obstacle=None):
    """Return a world with a course of 4 m to the north."""
    cylinders = np.array([obstacle]) if obstacle else np.zeros((0, 3))
    path = np.array([(1.0, 2.0), (1.0, 6.0)])
    course = Course((1.0, 2.0, math.pi / 2), (1.0, 10.0, math.pi / 2), 6.0, 0.4, path)
    return World("straight", cylinders, np.zeros((0, 5)), course)


def trial(
    obstacle=None, v=1.0, end=None, result=None, world=None, variant="ours", limit=50, **options
):
    planner = FakeMoveBase((v, 0.0), end=end, result=result, variant=variant)
    episode = Episode(
        sim_bridge.make("kinematic", slip=0.0),
        planner,
        period=2.0,
        time_limit=2.0 * limit,
        **options,
    )
    episode.reset(world or straight(obstacle), 0)
    return episode


def drive(episode, theta=SPACE.theta0, most=60):
    outcomes = []
    while not episode.outcome.over and len(outcomes) < most:
        outcomes.append(episode.decide(theta))
    return outcomes


def test_a_course_takes_the_time_it_takes_to_a_control_cycle():
    episode = trial()
    outcomes = drive(episode)
    last = outcomes[-1]
    assert (last.success, failed(last), last.timeout) == (True, False, False)
    assert last.time_s == pytest.approx(4.1, abs=0.15)
    assert (last.time_s / 0.05) % 1 == pytest.approx(0, abs=1e-6)
    assert last.decisions == len(outcomes) == 3
    assert [o.seconds for o in outcomes[:2]] == pytest.approx([2.0, 2.0])
    assert (last.seconds, last.path_length_m) == (
        pytest.approx(last.time_s - 4.0),
        pytest.approx(4.0, abs=0.1),
    )
    assert sum(o.progress for o in outcomes) == pytest.approx(4.0, abs=0.1)
    assert sum(o.progress_y for o in outcomes) == pytest.approx(4.0, abs=0.1)
    assert len(episode.drive.truth) == round(last.time_s / 0.05) + 1
    assert len(episode.drive.decisions) == 3
    with pytest.raises(RuntimeError, match="reset"):
        episode.decide(SPACE.theta0)


def test_each_course_of_an_episode_has_a_goal_of_its_own():
    episode = trial()
    (first,) = episode.drive.goals
    episode.reset(straight(), 1)
    (second,) = episode.drive.goals
    assert first.id != second.id


def test_a_planner_without_a_static_layer_also_drives_in_a_world_with_a_map():
    world = straight()
    mapped = replace(world, map=occupancy(world, 0.05))
    last = drive(trial(world=mapped))[-1]
    assert (last.success, last.time_s) == (True, drive(trial(world=world))[-1].time_s)


def test_the_goal_is_sent_once_in_odom_and_the_parameters_through_the_servers():
    episode = trial()
    drive(episode)
    base = episode.move_base
    assert (len(base.goals), base.goals[0][0]) == (1, pytest.approx((0.0, 8.0, math.pi / 2)))
    assert {s for s, _ in base.requests} == set(SPACE.servers)
    planner = dict(base.requests)["TrajectoryPlannerROS"]
    assert (planner["max_vel_theta"], planner["min_vel_theta"], planner["vx_samples"]) == (
        1.57,
        -1.57,
        6,
    )
    # Value in force in the planner.
    assert episode.outcome.theta[SPACE.names.index("vx_samples")] == 7
    assert np.array_equal(np.delete(episode.outcome.theta, 2), np.delete(SPACE.theta0, 2))
    assert base.steps[1][1] == pytest.approx((0.0, 0.0, math.pi / 2), abs=0.01)
    laser = base.scans[1].sensor_pose
    observation = PaperEncoding(robots.JACKAL).observe(episode.context())
    assert (laser, observation.shape) == (
        pytest.approx((0.0, 0.055, math.pi / 2), abs=0.01),
        (729,),
    )
    assert observation[720] == pytest.approx(episode.context().phi / math.pi)


def test_the_local_goal_is_relative_to_the_robot():
    episode = trial()
    # Plan: north-east, robot: north.
    assert episode.context().phi == pytest.approx(-math.pi / 4, abs=0.02)
    episode.move_base.global_plan = np.zeros((0, 3))
    episode.decide(SPACE.theta0)
    # Without a plan, the local goal is the goal.
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
            {**GIVEN_UP, "reason": "planner aborted: why"},
        ),
        (
            {"end": 50, "result": ("succeeded", "why")},
            True,
            {**GIVEN_UP, "reason": "planner succeeded: why"},
        ),
        # The time limit is not a final failure.
        (
            {"v": 0.0, "limit": 5},
            False,
            {"decisions": 5, "time_s": 10.0, "timeout": True, "aborted": False},
        ),
        # A stall is a failure if requested. The threshold of 0.85 m in 8 s is 0.106 m/s.
        ({"v": 0.0, "limit": 6}, False, {"decisions": 6}),
        (STALLS, True, {"decisions": 4, "reason": "stalled", "timeout": False}),
        ({**STALLS, "v": 0.10}, True, {"decisions": 4, "reason": "stalled", "timeout": False}),
        ({**STALLS, "v": 0.12}, False, {"decisions": 6, "reason": "time limit", "timeout": True}),
        (
            {**STALLS, "end": 160, "result": GIVES_UP},
            True,
            {"decisions": 4, "reason": "planner aborted: why"},
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
    last = outcomes[-1]
    assert {name: getattr(last, name) for name in ends} == ends
    assert (failed(last), last.decisions) == (fails, len(outcomes))
    assert "obstacle" not in options or last.min_clearance_m < 0.2
    assert "end_on_collision" not in options or last.time_s < 4


@pytest.mark.parametrize(
    ("planner_ends", "off", "left", "result", "reason"),
    [
        (True, 0.4, 0.0, None, "finished"),
        (False, 0.4, 0.0, None, "time limit"),  # Only the circle around the course's goal counts.
        (True, 0.9, 0.0, None, "time limit"),  # The error of the odometry is too large.
        (True, 0.0, 0.6, REACHED, "finished"),
        (True, 0.0, 0.9, REACHED, "planner succeeded: Goal reached."),
        (True, 0.0, 0.6, GIVES_UP, "planner aborted: why"),
    ],
)
def test_a_course_without_a_finish_line_ends_when_the_planner_has_arrived(
    planner_ends, off, left, result, reason
):
    """The planner arrives by odometry with a lateral error `off` [m], or reports a result `left`
    [m] before the goal.

    The robot drives over its goal, 4 m ahead, at 0.5 m/s. The planner's tolerance is .25 m.
    """
    goal = (1.0, 6.0, math.pi / 2)
    more = {"finish_y": None, "goal_tolerance": 0.25, "planner_ends": planner_ends}
    world = replace(straight(), course=replace(straight().course, goal=goal, **more))
    end = round((4.0 - left) / 0.5 / 0.05) if result else None
    episode = trial(v=0.5, limit=6, world=world, end=end, result=result)
    to_odom = episode.simulator.to_odom
    episode.simulator.to_odom = lambda pose: to_odom((pose[0] - off, *pose[1:]))
    episode.reset(replace(world, course=replace(world.course, goal=(1.0 + off, *goal[1:]))), 0)
    last = drive(episode)[-1]
    assert (last.success, last.reason) == (reason == "finished", reason)
    if last.success and off:  # The course ends as soon as the robot is within the tolerance.
        assert last.time_s == pytest.approx((4.0 - 0.25) / 0.5, abs=0.4)


def test_a_laser_of_5_hz_scans_in_every_fourth_cycle():
    robot = robots.load("turtlebot3_burger")
    planner = FakeMoveBase((0.1, 0.0))
    episode = Episode(sim_bridge.make("kinematic", robot=robot), planner, robot, period=2.0)
    episode.reset(straight(), 0)
    episode.decide(episode.space.theta0)
    seen = [scan is not None for scan in planner.scans]
    assert seen == [k % 4 == 0 for k in range(41)]


FIELDS = (
    "phi",
    "progress",
    "progress_y",
    "last_scan_min",
    "decision_min",
    "contact",
    "collided",
    "seconds",
)
FIELDS += (
    "time_s",
    "path_length_m",
    "min_clearance_m",
    "mean_clearance_m",
    "mean_jerk",
    "mean_turn",
    "mean_range",
)
GOLDEN = (
    (-1.48, 0.73, 0.82, 0.51, 0.45, 0, 0, 1, 1, 0.82, 0.45, 0.54, 9.74, 0.44, 4.50),
    (-2.86, 1.15, 1.30, 0.15, 0.15, 1, 1, 1, 2, 2.13, 0.15, 0.55, 34.91, 2.47, 3.77),
    (-2.64, -0.33, -0.57, 0.79, 0.15, 1, 1, 1, 3, 2.79, 0.15, 0.50, 26.71, 2.40, 4.51),
    (2.99, -0.24, -0.32, 1.13, 0.79, 0, 1, 1, 4, 3.13, 0.15, 0.60, 22.29, 2.39, 4.75),
)


def test_the_pose_of_a_laser_that_is_mounted_aside_and_turned():
    laser = robots.JACKAL.laser.model_copy(update={"pose": (0.1, 0.2, 0.5)})
    turned_left = 0.5 * math.pi
    expected = (1.0 - 0.2, 2.0 + 0.1, turned_left + 0.5)
    assert laser.pose_at((1.0, 2.0, turned_left)) == pytest.approx(expected)


def test_the_first_beam_of_a_turned_laser_is_seen_in_its_direction_from_the_robot():
    laser = robots.JACKAL.laser.model_copy(update={"pose": (0.1, 0.0, 0.5)})
    episode = trial(robot=replace(robots.JACKAL, laser=laser))
    _, first_angle, _ = episode.seen().scan
    assert first_angle == pytest.approx(laser.first_angle + 0.5)


@pytest.mark.parametrize(("contact", "counts"), [(2.0, False), (2.05, True)])
def test_a_contact_at_the_very_beginning_belongs_to_the_course_before(contact, counts):
    drive = Drive(contacts=np.array([contact]))
    goal = Goal("g", begin=2.0, end=4.0, status="reached")
    leg = Leg(2.0, 4.0, (2.0, 0.0, 0.0), (0.0, 0.0), (2.0, 0.0))
    outcome = outcome_of(drive, goal, leg, SPACE.theta0, 1, body_width=0.4)
    assert outcome.collided is counts
    assert outcome.contact is counts


def test_outcome_of_each_decision_of_a_drive():
    """In one decision each, the robot passes a post, touches another, backs off, and turns. The
    goal is to the left.
    """
    course = straight().course
    course = replace(course, goal=(-3.0, 10.0, math.pi / 2))
    world = World("posts", np.array([(1.55, 2.6, 0.1), (1.1, 4.5, 0.2)]), np.zeros((0, 5)), course)
    planner = FakeMoveBase((1.0, 0.0), (1.5, 0.0), (-0.8, 0.0), (-0.3, 0.8))
    episode = Episode(sim_bridge.make("kinematic", slip=0.0), planner, period=1.0)
    episode.reset(world, 0)
    for row in GOLDEN:
        outcome = episode.decide(SPACE.theta0)
        seen = episode.context()
        values = {
            **vars(outcome),
            "phi": seen.phi,
            "mean_range": np.minimum(seen.ranges, 5.0).mean(),
        }
        assert {name: float(values[name]) for name in FIELDS} == pytest.approx(
            dict(zip(FIELDS, row)), abs=6e-3
        )


def test_the_monitor_gets_the_scans_and_the_planner_is_informed_of_blocked_commands():
    """The monitor does not affect a free course. Before a wall it stops the robot and informs the
    planner.
    """
    free = trial(monitor=True)
    assert drive(free)[-1].success
    assert not any(free.move_base.held[1:])
    before_wall = trial(WALL, monitor=True, limit=3)
    assert not drive(before_wall)[-1].collided
    assert before_wall.move_base.held[-1]


@pytest.mark.parametrize(
    ("variant", "escapes", "moves"),
    [("cpp-like", True, True), ("cpp-like", False, False), ("ours", True, False)],
)
def test_the_monitor_moves_the_robot_if_a_cpp_like_planner_finds_no_command(
    variant, escapes, moves
):
    """The planner `ours` makes its escape motions itself."""
    episode = trial(v=0.0, monitor=True, limit=2, variant=variant, escapes=escapes)
    given = []
    judge = episode.stack.monitor.filter
    episode.stack.monitor.filter = lambda *a, creeps: (
        given.append((a[3], creeps)),
        judge(*a, creeps=creeps),
    )[1]
    drive(episode)
    assert all(creeps == (command == (0.0, 0.0)) for command, creeps in given), (
        "only the planner's commands may creep"
    )
    twists = episode.drive.truth.twist
    assert twists.any() == moves
    assert not twists[:40].any(), "the monitor waits two seconds for the planner"


def test_nearest_is_bounded_and_finite_for_any_scan():
    assert nearest(np.array([np.nan, 0.5, np.inf, 3.0], np.float32), 0.1) == pytest.approx(0.5)
    assert nearest(np.array([-np.inf, 0.5], np.float32), 0.1) == 0.1
    assert nearest(np.full(3, np.nan, np.float32), 0.1) == math.inf


# -- reward: the paper's section III-C -------------------------------------------------------------
STEP = Outcome(np.zeros(8), progress=0.9, progress_y=0.8, last_scan_min=0.4, decision_min=0.2)
STEP = replace(STEP, contact=True, seconds=2.0, decisions=3)
TERMS = ("time", "progress", "clearance", "collision")


def earned(reward, outcome, limit=50, period=2.0, scale=1.0, pace=1.0):
    return reward(outcome, limit, period, SimpleNamespace(scale=scale, pace=pace))


def test_the_reward_has_the_papers_terms():
    total, terms = earned(Reward(c_f=1.0, c_p=2.0, c_c=0.1), STEP)
    assert terms == pytest.approx(dict(zip(TERMS, (-1.0, 1.8, -0.25, 0.0))))
    assert total == pytest.approx(0.55)
    everything = Reward(along_y=True, exact_time=True, lowest=True, c_collision=3.0)
    _, terms = earned(everything, replace(STEP, seconds=0.5, success=True))
    assert terms == pytest.approx(dict(zip(TERMS, (-0.25, 0.8, -0.25, -3.0))))
    # R_f is 0 at the goal.
    assert earned(Reward(), replace(STEP, success=True))[1]["time"] == 0.0
    with pytest.raises(ValueError, match="should be a finite number"):
        Reward(c_p=float("nan"))


def test_distance_is_bounded_both_ways():
    clear = Reward(c_c=1.0)
    assert earned(clear, replace(STEP, last_scan_min=math.inf))[1]["clearance"] == -0.5
    for lowest in (0.1, 0.0):  # A laser whose range_min is 0 may report 0.
        assert earned(clear, replace(STEP, last_scan_min=lowest))[1]["clearance"] == pytest.approx(
            -10.0
        )


def test_a_failure_pays_for_the_time_until_the_limit():
    fallen = replace(STEP, flipped=True, decisions=45)
    assert earned(Reward(), fallen)[1]["time"] == -6.0
    assert earned(Reward(), replace(fallen, decisions=3))[1]["time"] == -1.0 - 20.0
    assert (
        earned(Reward(failure_seconds=11.0), replace(fallen, decisions=3))[1]["time"] == -1.0 - 5.5
    )
    assert earned(Reward(), replace(STEP, timeout=True))[1]["time"] == -1.0


def test_times_are_scaled_by_the_pace_of_the_robot():
    """For a robot four times slower than the Jackal, a course and a failure have the same relative
    cost.
    """
    everything = Reward(exact_time=True, c_c=0.1)
    _, terms = earned(everything, STEP, pace=4.0)
    assert terms == pytest.approx(dict(zip(TERMS, (-0.25, 0.9, -0.0625, 0.0))))
    once, twice = (earned(Reward(), STEP, scale=scale)[1]["progress"] for scale in (1.0, 2.0))
    assert once == 2.0 * twice != 0.0
    assert earned(Reward(), STEP, pace=4.0)[1]["time"] == -0.25
    fallen = replace(STEP, flipped=True, decisions=3)
    assert earned(Reward(failure_seconds=11.0), fallen, pace=4.0)[1]["time"] == -0.25 - 5.5
    # Limited by the time left.
    assert earned(Reward(), fallen, pace=4.0)[1]["time"] == -0.25 - 47 / 4
    husky = DimensionlessEncoding(robots.load("husky"), 1.0)  # .68 m wide, 1 m/s
    judged = Reward(exact_time=True)(STEP, 50, 2.0, husky)
    assert judged[1]["time"] == pytest.approx(-1.0 / (0.68 / 0.53 * 2.0))


# -- the environment -------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def env():
    import training.env.env

    environment = gymnasium.make(
        training.env.ID, worlds="generated:0,generated:1", simulator="kinematic", time_limit=6.0
    )
    yield environment
    environment.close()


def test_the_environment_made_by_name_passes_gymnasiums_check():
    from gymnasium.utils.env_checker import check_env

    name = "training.env:applr_ros1/Navigation-v0"
    environment = gymnasium.make(name, worlds="generated:7", time_limit=4.0)
    check_env(environment.unwrapped)
    environment.close()


def test_the_same_seed_gives_the_same_episode(env):
    def run(seed):
        rng = np.random.default_rng(0)
        observation, info = env.reset(seed=seed)
        rows = [observation]
        while True:
            observation, reward, terminated, truncated, info = env.step(
                rng.uniform(-1, 1, 8).astype(np.float32)
            )
            rows.append(np.append(observation, reward))
            if terminated or truncated:
                return np.concatenate(rows), info, terminated, truncated

    a, info, *ended = run(5)
    b, again, *_ = run(5)
    assert np.array_equal(a, b)
    assert info["world"] == again["world"]
    assert (*ended, info["timeout"], info["decisions"]) == (False, True, True, 3)
    assert not np.array_equal(a, run(6)[0])
    assert {env.reset(seed=s)[1]["world"] for s in range(12)} == {"generated:0", "generated:1"}
    assert {env.reset(seed=s, options={"world": 1})[1]["world"] for s in range(6)} == {
        "generated:1"
    }


def test_theta_in_the_observation_is_in_force_in_the_planner(env):
    env.reset(seed=0)
    action = np.array([0.3, -0.2, 0.13, 0.4, -0.9, 1.0, -1.0, 0.5], np.float32)
    observation, _, _, _, info = env.step(action)
    theta = PaperEncoding(robots.JACKAL).theta(action)
    assert np.allclose(info["theta"], theta)
    np.testing.assert_allclose(
        observation[721:], PaperEncoding(robots.JACKAL).action(theta), atol=1e-6
    )
    configuration = env.unwrapped.episode.move_base.configuration("TrajectoryPlannerROS")
    assert (configuration["max_vel_x"], configuration["vx_samples"]) == (
        pytest.approx(theta[0]),
        theta[2],
    )
    assert configuration["min_vel_theta"] == pytest.approx(-theta[1])
    assert set(info["reward"]) == set(TERMS)


def test_the_decision_period_changes_the_steps_but_not_the_cost_of_a_second():
    from training.env.env import ApplrEnv

    for period, limit in ((2.0, 50), (0.5, 200)):
        env = ApplrEnv(worlds="generated:0", period=period, reward={"exact_time": True})
        env.reset(seed=1)
        action = env.encoding.action(env.space.theta0)
        cost = 0.0
        info = {"time_s": 0.0}
        over = False
        before = 0.0
        while not over:
            before = info["time_s"]
            _, _, terminated, truncated, info = env.step(action)
            cost = cost + info["reward"]["time"]
            over = terminated or truncated
            assert over or info["time_s"] - before == pytest.approx(period)
        env.close()
        assert (terminated, truncated, info["success"]) == (True, False, True)
        assert (env.episode.limit, cost) == (limit, pytest.approx(-info["time_s"] / 2.0))
        assert info["decisions"] - 1 < info["time_s"] / period <= info["decisions"] + 1e-6
    with pytest.raises(ValueError, match="multiple of 0.05"):
        ApplrEnv(worlds="generated:0", period=0.07)


@pytest.mark.parametrize("movers", [False, True])
def test_the_costmaps_get_predicted_obstacle_points_if_the_settings_request_them(movers):
    from training.env.env import ApplrEnv

    def marked():
        (layer,) = env.episode.move_base.local_costmap.obstacle_layers
        return sum(len(cloud.points) for buffer in layer.buffers[1:] for cloud in buffer.clouds)

    env = ApplrEnv("dynamic:401", period=1.0, movers=movers)
    for _ in range(2):
        env.reset(seed=0)
        assert marked() == 0, "the tracker has no moving obstacle yet"
        for _ in range(3):
            env.step(np.zeros(env.action_space.shape, np.float32))
        assert (marked() > 20) == movers
    env.close()


def test_a_course_begins_without_a_scan_of_the_previous_course():
    settings = {"simulator": "kinematic", "observation": "dimensionless", "period": 1.0}
    env = gymnasium.make("training.env:applr_ros1/Navigation-v0", worlds="generated:7", **settings)
    env.reset(seed=0)
    seen = [env.step(np.zeros(env.action_space.shape, np.float32))[0], env.reset(seed=1)[0]]
    # Now and earlier.
    scans = [np.split(observation[: env.unwrapped.encoding.scan], 2) for observation in seen]
    assert [np.array_equal(*pair) for pair in scans] == [False, True]
    env.close()


def test_the_observation_has_moving_obstacles_relative_to_a_robot_that_turns():
    """The robot starts at (1, 2) in the world, the origin of its odometry, and turns by more than 2
    rad.
    """
    # Across the course at 1.25 m/s.
    walker = Mover(0.25, ((0.0, -1.5, 4.0), (4.0, 3.5, 4.0)))
    simulator = sim_bridge.make("kinematic", slip=0.0)
    planner = FakeMoveBase((0.0, 0.6))
    planner.parameters = {"applr": {"movers": True}}
    planner.sources = ("front/scan",)
    episode = Episode(simulator, planner, period=0.5)
    encoding = DimensionlessEncoding(robots.JACKAL, 0.5)
    episode.layout = encoding.layout
    entries = {}
    for movers in ((), (walker,)):
        episode.reset(replace(straight(), movers=movers), 0)
        drive(episode, most=3)
        entries[len(movers)] = encoding.observe(episode.context())[-12:]
    assert entries[0].tolist() == [1.0, 0.0, 0.0, 0.0] * 3
    assert entries[1][4:].tolist() == [1.0, 0.0, 0.0, 0.0] * 2
    state = simulator.state
    assert state.pose[2] > 2.0
    x, y = transform_point(inverse(state.pose), *walker.position(state.time))
    vx, vy = transform_point((0.0, 0.0, -state.pose[2]), 1.25, 0.0)
    seen = entries[1][:4] * ([15.0 * encoding.width] * 2 + [robots.JACKAL.base.max_speed] * 2)
    np.testing.assert_allclose(seen, [x, y, vx, vy], atol=0.2)
