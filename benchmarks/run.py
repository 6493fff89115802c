"""Benchmarks for docs/explanation/results.md: `python -m benchmarks.run [NAME ...]`, on an
idle machine.

Each benchmark is a function that returns its value and unit. Planner and simulators run in one
thread and are measured in processor time. For similar scenarios, the C++ planners take 1,620 us
(planner_cycle_default), 15,700 us (_max), 179 us (inflation) and 1,076 us (navfn) by
tests/golden/FORMAT.md, and 1,170 us (DWA) by tests/golden_dwa/FORMAT_DWA.md.
"""

import sys
import time
from statistics import median
from types import SimpleNamespace
from unittest.mock import patch

import numpy as np

import sim_bridge
import worlds
from applr_ros1 import robots
from applr_ros1.drives.simulate import CourseDrive
from applr_ros1.monitor.monitor import CollisionMonitor
from applr_ros1.movers.prediction import Prediction
from applr_ros1.planner.costmap.inflation_layer import InflationLayer
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.navfn.navfn import Navfn
from applr_ros1.planner.warm_up import warm_up
from applr_ros1.policy import methods
from applr_ros1.policy.decision import Context
from applr_ros1.policy.parameter_space import SPACE
from applr_ros1.stack.simulated import SimulatedRobot
from applr_ros1.stack.stack import Stack
from tests.planner import replay_dwa, replay_golden
from tests.support import ROOT
from tests.support.robots import JACKAL_PARAMETERS, make_weights
from tests.support.training import episode

COURSES = (3, 60, 140, 250)  # numbers of built-in worlds, from sparse to dense
SECONDS = 20  # maximum simulated time per course [s]
# Sizes of the networks of the paper, for the Jackal
BATCH = 256
OBSERVATIONS = 729
ACTIONS = 8
HIDDEN = (512, 512, 512)


def planner_cycle_default():
    """Measure one choice of a velocity among 6 x 20 samples, with the Jackal's parameters."""
    return _trajectory_planner({})


def planner_cycle_max():
    """Measure one choice among 12 x 40 samples at up to 2 m/s, driving at 1.6 m/s."""
    highest_parameters = dict(
        max_vel_x=2.0, max_vel_theta=3.14, min_vel_theta=-3.14, vx_samples=12, vtheta_samples=40
    )
    return _trajectory_planner(highest_parameters, velocity=(1.6, 0.0, 0.3))


def _trajectory_planner(changes, velocity=None):
    """Return the median time of one choice over twenty scenarios of the golden set."""
    choice_times = []
    for scenario in _of_samples("golden", vx_samples=6, vtheta_samples=20)[:20]:
        costmap = replay_golden.make_costmap(scenario)
        planner = replay_golden.make_planner(scenario, costmap)
        planner.reconfigure(changes)
        planner.set_plan(scenario.array("plan"))
        scene = costmap, scenario.inputs["pose"], velocity or scenario.inputs["vel"]
        choice_times.append(_choice(planner, [0] * 10, *scene))
    return median(choice_times), "us (median of %d scenarios)" % len(choice_times)


def dwa_planner_cycle():
    """Measure one choice with the TurtleBot3 burger's parameters: 861 samples of 1.5 s on a map of
    3 x 3 m.
    """
    choice_times = []
    for scenario in _of_samples("golden_dwa", vx_samples=20, vy_samples=1, vth_samples=40):
        # Without a legal command the planner ends early.
        has_legal_command = scenario.expected["best"]["index"] >= 0
        if scenario.robot != "burger" or not has_legal_command:
            continue
        costmap = replay_dwa.make_costmap(scenario)
        planner = replay_dwa.make_planner(scenario)
        scene = costmap, scenario.array("plan"), scenario.inputs["pose"], scenario.inputs["vel"]
        choice_times.append(_choice(planner, replay_dwa.flags_in(scenario), *scene))
    return median(choice_times), "us (median of %d scenarios)" % len(choice_times)


def _of_samples(name, **samples):
    """Return the scenarios of a golden set with these numbers of samples."""
    chosen_scenarios = []
    for scenario in replay_golden.load(ROOT / "tests" / name):
        if scenario.kind == "dwa" and samples.items() <= scenario.inputs["params"].items():
            chosen_scenarios.append(scenario)
    return chosen_scenarios


def _choice(planner, state, *scene):
    """Return the median processor time of findBestPath [us]."""
    planner.find_best_path(*scene)  # The first call loads the kernels.
    cycle_times = []
    for _ in range(30):
        # Flags of the cycle before would change what is sampled.
        planner.state = state
        began = time.thread_time()
        planner.find_best_path(*scene)
        cycle_times.append(time.thread_time() - began)
    return 1e6 * median(cycle_times)


def control_cycle():
    """Measure the mean time of MoveBase.step (scan, both costmaps, plan, control) with the Jackal's
    parameters.
    """
    return _share(*_time_in_drives(MoveBase, "step", lambda _, cycle: cycle.controlled))


def monitor():
    """Measure the collision monitor in one control cycle: taking a scan, and filtering a
    command.
    """
    taken, _ = _time_in_drives(CollisionMonitor, "add_scan", lambda *_: True, monitor=True)
    filtered, count = _time_in_drives(CollisionMonitor, "filter", lambda *_: True, monitor=True)
    return _share(taken + filtered, count)


def tracker():
    """Measure the tracker of moving obstacles on one scan, and the prediction of their points."""
    return _share(*_time_in_drives(Prediction, "add_scan", lambda *_: True, applr={"movers": True}))


def decision():
    """Measure one decision of the Jackal's policy, once a second: encoding of the observation, and
    networks.
    """
    policy = methods.make("applr", robots.JACKAL)
    simulated = _simulated("kinematic", MoveBase(JACKAL_PARAMETERS), monitor=True)
    course_drive = _begun(simulated, 140)
    context = Context.of(course_drive.theta, course_drive.seen, SPACE, policy.layout)
    milliseconds = 1e3 / _rate(lambda: policy.theta(context))
    return milliseconds, "ms (%.2f %% of a core at 1 Hz)" % (0.1 * milliseconds)


def _share(mean, count):
    """Return a mean time [s] in ms, and its unit with the share of a core at 20 Hz."""
    percent = 100.0 * 20.0 * mean
    return 1e3 * mean, "ms (mean over %d cycles; %.1f %% of a core at 20 Hz)" % (count, percent)


def inflation():
    """Measure one update of the local costmap's inflation layer while driving: 200 x 200 cells,
    radius 0.3 m.
    """

    def is_of_local_costmap(arguments, _):
        """Return whether a call updates the local costmap."""
        master, *_ = arguments
        return master.shape == (200, 200)

    mean, count = _time_in_drives(InflationLayer, "inflate", is_of_local_costmap)
    return 1e6 * mean, "us (mean over %d updates)" % count


def navfn():
    """Measure one plan on the changing global costmap, 800 x 800 cells, from the driving robot to
    the goal.
    """
    mean, count = _time_in_drives(Navfn, "plan", lambda *_: True, planner_frequency=20.0)
    return 1e6 * mean, "us (mean over %d plans)" % count


def _time_in_drives(kind, name, counts, monitor=False, **parameters):
    """Return the mean time [s] of the calls that `counts` accepts, and the number of these calls.

    `counts` gets the arguments of a call, and its result.
    The time is the least of 3 drives, the number that of the last drive.
    """
    warm_up()
    method = getattr(kind, name)
    call_times = []
    mean_times = []

    def timed(instance, *arguments, **keywords):
        """Call the method, and note its time if it counts."""
        began = time.process_time()
        result = method(instance, *arguments, **keywords)
        if counts(arguments, result):
            call_times.append(time.process_time() - began)
        return result

    with patch.object(kind, name, timed):
        for _ in range(3):
            call_times.clear()
            move_base = MoveBase({**JACKAL_PARAMETERS, **parameters})
            _drive(_simulated("kinematic", move_base, monitor), lambda rng: SPACE.theta0)
            mean_times.append(np.mean(call_times))
    # Other programs can only add to a time.
    return min(mean_times), len(call_times)


def sim_speed_kinematic():
    """Measure simulated seconds per second of one core with random parameters, resets included."""
    return _speed("kinematic")


def sim_speed_pybullet():
    """Measure the same with PyBullet."""
    return _speed("pybullet")


def _speed(simulator):
    """Return the highest speed of several drives, and its unit."""
    warm_up()
    # At this frequency there is a new plan in every control cycle.
    move_base = MoveBase(dict(JACKAL_PARAMETERS, planner_frequency=20.0))
    simulated = _simulated(simulator, move_base)

    def random_theta(rng):
        """Return a parameter set drawn evenly from the whole space."""
        return SPACE.to_theta(rng.uniform(-1.0, 1.0, len(SPACE)))

    highest_speed = 0.0
    # A short drive first, which loads what the others need.
    for seconds in (2, SECONDS, SECONDS, SECONDS):
        began = time.process_time()
        simulated_s = _drive(simulated, random_theta, seconds)
        highest_speed = max(highest_speed, simulated_s / (time.process_time() - began))
    return highest_speed, "simulated s per processor s"


def _simulated(simulator, move_base, monitor=False):
    """Return a simulated Jackal."""
    stack = Stack(robots.JACKAL, move_base, monitor=monitor)
    return SimulatedRobot(sim_bridge.make(simulator), stack)


def _begun(simulated, course_number):
    """Return a drive at its begin, with two seconds between decisions."""
    world = worlds.load("generated:%d" % course_number)
    return CourseDrive(simulated, world, course_number, period=2.0, theta=SPACE.theta0)


def _drive(simulated, theta, seconds=SECONDS):
    """Drive the courses with theta(random generator) at each decision, and return the simulated
    seconds.
    """
    rng = np.random.default_rng(0)
    simulated_s = 0.0
    for course_number in COURSES:
        course_drive = _begun(simulated, course_number)
        for _ in range(round(seconds / course_drive.period)):
            course_drive.decide(theta(rng))
            course_drive.advance()
            simulated_s += course_drive.outcome.seconds
            if course_drive.has_ended:
                break
    return simulated_s


def td3_updates():
    """Measure gradient steps, half of them with a policy update, and the sampling of batches."""
    from training.env.trajectory import TransitionLayout
    from training.train.learner.config import LearnerOptions
    from training.train.learner.learner import draw_batch
    from training.train.replay.buffer import ReplayBuffer
    from training.train.td3.td3 import TD3

    layout = TransitionLayout()
    options = LearnerOptions(net_arch=list(HIDDEN), batch_size=BATCH)
    replay = ReplayBuffer(layout, 7200)
    rng = np.random.default_rng(0)
    for episode_number in range(460):
        replay.add(
            episode(layout, episode_number, 13, terminated=episode_number % 10 > 0, version=0)
        )
    td3 = TD3(OBSERVATIONS, ACTIONS, options)
    return _rate(lambda: td3.update(draw_batch(replay, rng, options, td3.device))), "updates/s"


def sb3_td3_updates():
    """Measure TD3.train of stable-baselines3 with the same sizes, on prepared batches (without
    sampling).
    """
    import gymnasium
    import stable_baselines3
    import torch

    class Spaces(gymnasium.Env):
        observation_space = gymnasium.spaces.Box(-1, 1, (OBSERVATIONS,), np.float32)
        action_space = gymnasium.spaces.Box(-1, 1, (ACTIONS,), np.float32)

    model = stable_baselines3.TD3(
        "MlpPolicy",
        Spaces(),
        batch_size=BATCH,
        buffer_size=10,
        policy_kwargs={"net_arch": list(HIDDEN)},
    )
    model.set_logger(stable_baselines3.common.logger.Logger(None, []))

    def random(columns):
        return torch.rand(BATCH, columns) * 2 - 1

    batch = SimpleNamespace(
        observations=random(OBSERVATIONS),
        actions=random(ACTIONS),
        rewards=random(1),
        next_observations=random(OBSERVATIONS),
        dones=torch.zeros(BATCH, 1),
        discounts=random(1),
    )
    model.replay_buffer.sample = lambda *arguments, **options: batch
    # train(2) makes two updates, one of them with the policy's.
    return _rate(lambda: model.train(2, BATCH)) * 2, "updates/s"


def actor_inference():
    """Measure one pass of an observation through the actor, as in the node: numpy, 729 -> 3 x 512
    -> 8.
    """
    from applr_ros1.policy.actor import Policy

    actor = Policy.of(make_weights(hidden=HIDDEN, inputs=OBSERVATIONS, outputs=ACTIONS))
    observation = np.random.default_rng(0).uniform(-1, 1, OBSERVATIONS).astype(np.float32)
    return 1e6 / _rate(lambda: actor.action(observation)), "us"


def _rate(step, rounds=5, seconds=0.6):
    """Return the best rate of `rounds` rounds of `seconds` [s], in steps per second of wall
    time.
    """
    # The first steps compile and load.
    for _ in range(8):
        step()
    highest_rate = 0.0
    for _ in range(rounds):
        began = time.perf_counter()
        step_count = 0
        # At least 4 steps, so that the clock's own call hardly counts.
        while step_count < 4 or time.perf_counter() - began < seconds:
            step()
            step_count += 1
        highest_rate = max(highest_rate, step_count / (time.perf_counter() - began))
    return highest_rate


def reconfigure_all():
    """Measure changing all eight parameters of an idle move_base node over ROS at 20 Hz, with every
    value read back.
    """
    from applr_ros1.nodes.applr.reconfigure_client import ReconfigureClient
    from tests.support.ros import session, wait_for

    node = session().node("move_base", "cmd_vel:=/cmd_vel")
    client = ReconfigureClient()
    times_ms = []
    # A node that has ended never has servers: the calls below then report the error.
    wait_for(
        lambda: client.connected or not node.alive() or not client.connect(), "parameter servers"
    )
    rng = np.random.default_rng(0)
    for _ in range(200):
        theta = SPACE.to_theta(rng.uniform(-1.0, 1.0, len(SPACE)))
        began = time.monotonic()
        error_message = client.apply(SPACE.settings(theta))
        times_ms.append(1e3 * (time.monotonic() - began))
        assert not error_message, error_message
        # The rest of the period of 20 Hz
        time.sleep(max(0.0, 0.05 - 1e-3 * times_ms[-1]))
    client.close()
    return np.percentile(times_ms, 95), "ms (p95)"


FIGURES = (
    planner_cycle_default,
    planner_cycle_max,
    dwa_planner_cycle,
    inflation,
    navfn,
    control_cycle,
    monitor,
    tracker,
    decision,
    sim_speed_kinematic,
    sim_speed_pybullet,
    td3_updates,
    sb3_td3_updates,
    actor_inference,
    reconfigure_all,
)

if __name__ == "__main__":
    for figure in FIGURES:
        if figure.__name__ in sys.argv[1:] or not sys.argv[1:]:
            print("%-28s %.3f %s" % (figure.__name__, *figure()), flush=True)
