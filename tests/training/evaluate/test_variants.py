"""Tests of planner fidelity: the draw from the seed, and a drive for each reproduced defect of the
C++ planner.
"""

import json
import math

import pytest

from applr_ros1.common.errors import ApplrError
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.state_machine import NO_PATH, OSCILLATING
from applr_ros1.planner.variant import draw
from tests.support.robots import Scripted, ToyRobot, quick, ring, run


def test_the_random_planner_fidelity_depends_only_on_the_seed():
    drawn_planners = [draw("drawn", seed) for seed in range(200)]
    for seed, planner in enumerate(drawn_planners):
        assert draw("drawn", [seed]) == planner
    assert set(drawn_planners) == {"ours", "cpp-like"}
    assert 70 < drawn_planners.count("ours") < 130

    move_base = MoveBase(quick(), "drawn")
    for seed, planner in enumerate(drawn_planners[:8]):
        move_base.reset(0.0, seed=seed)
        assert move_base.variant == planner
        move_base.reset(0.0)
        assert move_base.variant == planner, "without a seed the planner stays"
    with pytest.raises(ApplrError, match=r"^planner 'cpp' is unknown: use .* or drawn$"):
        MoveBase(quick(), "cpp")


# -- drives with the defects of C++ ----------------------------------------------------------------


def first_recovery(planner, seed, **changes):
    """Return the time from the goal to the first recovery [s], of a robot that stands with valid
    commands.
    """
    tree = quick(oscillation_timeout=1.0, clearing_rotation_allowed=False, **changes)
    move_base = MoveBase(tree, planner=planner, seed=seed)
    robot = ToyRobot()
    cycles = []
    run(move_base, robot, 0.1)
    move_base.set_goal((3.0, 0.0, 0.0), robot.time)
    # A robot that stands still counts as oscillating.
    move_base.local_planner = Scripted(lambda n: (True, (0.0, 0.0)))
    result = run(move_base, robot, 60.0, cycles=cycles)
    assert result in (("aborted", OSCILLATING), None)
    recovery_times = [time for time, cycle in cycles if cycle.recovery]
    # The goal was set at 0.1 s.
    return min(recovery_times, default=math.inf) - 0.1


def test_a_due_recovery_is_skipped_while_plans_succeed():
    # oscillation_timeout is 1 s. In C++ each plan that succeeds restarts the state machine, so that
    # the recovery comes when a cycle happens to fall between two plans.
    assert first_recovery("ours", 0) == pytest.approx(1.0, abs=0.16)
    late_times = [first_recovery("cpp-like", seed) for seed in range(3)]
    assert len(set(late_times)) == 3
    assert min(late_times) > 1.5
    assert max(late_times) > 5.0
    assert first_recovery("cpp-like", 0) == late_times[0], "the same seed, the same drive"
    # C++ recovers in time as well if it plans only once.
    assert first_recovery("cpp-like", 0, planner_frequency=0.0) == pytest.approx(1.0, abs=0.16)


def test_clearing_recoveries_find_no_layer_of_their_name():
    """Obstacles vanish, and no beam behind them returns. Only a recovery clears such obstacles from
    the maps.
    """
    results = {}
    for planner in ("ours", "cpp-like"):
        move_base = MoveBase(quick(), planner=planner)
        robot = ToyRobot(circles=ring(0.0, 0.0, 2.2, posts=80, size=0.1))
        cycles = []
        for yaw in (2.0, 4.0, 0.0):
            robot.pose = (0.0, 0.0, yaw)
            run(move_base, robot, 0.1)
        robot.circles = robot.circles[:0]
        move_base.set_goal((4.0, 0.0, 0.0), robot.time)
        results[planner] = run(move_base, robot, 60.0, cycles=cycles)

    # C++ keeps the last command of the rotation in force; for ours see test_move_base.py.
    commands_after_turns = []
    for (_, cycle), (_, following) in zip(cycles, cycles[1:]):
        if cycle.state == "clearing" and following.state != "clearing":
            commands_after_turns.append(following.command)
    assert commands_after_turns[0] is None

    # The layers of the Jackal's files are called otherwise than C++'s recoveries expect.
    assert results == {
        "ours": ("succeeded", "Goal reached."),
        "cpp-like": ("aborted", NO_PATH),
    }


def test_success_waits_for_a_cycle_without_a_new_plan():
    arrival_times = {}
    for planner in ("ours", "cpp-like"):
        move_base = MoveBase(quick(), planner=planner, seed=4)
        robot = ToyRobot()
        move_base.set_goal((1.0, 0.0, 0.0), 0.0)
        assert run(move_base, robot, 120.0) == ("succeeded", "Goal reached.")
        assert abs(robot.pose[0] - 1.0) < 0.3
        arrival_times[planner] = robot.time
    assert arrival_times["cpp-like"] > arrival_times["ours"] + 2.0


# -- evaluation and training -----------------------------------------------------------------------
def test_the_planner_reaches_training_and_evaluation():
    pytest.importorskip("torch")
    pytest.importorskip("gymnasium")

    import worlds
    from training.env.env import ApplrEnv
    from training.evaluate.runner import TrialRunner
    from training.train.learner.config import TrainConfig
    from training.train.learner.prepare import prepare

    # Given: the environment and the periodic evaluation of a run
    config = TrainConfig(
        worlds="generated:0",
        eval_worlds="generated:1",
        planner="drawn",
        end_on_collision=True,
        monitor=True,
        movers=True,
        ground=[0, 2],
    )
    prepared = prepare(config)
    env = ApplrEnv(**json.loads(prepared.collect.args[1]))
    runner = TrialRunner(prepared.drive.args[0])

    # Then: the environment draws a planner from the seed of each episode
    variants = []
    for seed in [*range(8), 0]:
        env.reset(seed=seed)
        variants.append(env.simulated.stack.move_base.variant)
    assert set(variants) == {"ours", "cpp-like"}
    assert variants[8] == variants[0]
    assert 0.0 < env.simulated.simulator.drawn.ground < 2.0

    # The evaluation has a fixed one, and drives on after a contact.
    runner.simulated.reset(worlds.load("generated:1"), 0)
    assert runner.simulated.stack.move_base.variant == "ours"
    # It has the better simulator, not the faster one of the episodes.
    assert runner.settings.simulator == "pybullet"
    assert TrainConfig(planner="cpp-like").judged["planner"] == "cpp-like"
    assert env.rules.end_on_contact
    assert not runner.rules.end_on_contact
    for simulated in (env.simulated, runner.simulated):
        assert simulated.stack.monitor
        assert simulated.stack.prediction
