"""Replay of the DWA planner's golden scenarios (format planner-golden-2-dwa), one function per kind
of scenario.

Used by replay_golden.py. Each function yields (quantity, ours, expected), and a tolerance if the
numbers cannot match to the last bit.
"""

from types import SimpleNamespace

import numpy as np

from applr_ros1.planner.dwa.critics.registry import ALL
from applr_ros1.planner.dwa.local_planner import (
    DRIVING,
    NO_PLAN,
    STOPPING,
    TURNED,
    TURNING,
    DWALocalPlanner,
    LocalPlan,
)
from applr_ros1.planner.dwa.planner import DWAPlanner
from applr_ros1.planner.parameters.dwa_planner_parameters import DWA_PLANNER

FORMAT = "planner-golden-2-dwa"
# Distances of the four map grid critics, in the order of planner.grids().
GRIDS = ("path_dist", "goal_dist", "goal_front_dist", "alignment_dist")
# In the order of the numbers in the sets.
PHASES = (NO_PLAN, DRIVING, STOPPING, TURNING, TURNED)
THROUGH = 255  # value in `cut` if the search scored a sample with all critics
ANOTHER_FRAME = 1e-9  # tolerance of poses transformed from another frame [m, rad]

# Defaults for the parameters that C++ does not have
DEFAULTS = {parameter.name: parameter.default for parameter in DWA_PLANNER}


def make_costmap(scenario):
    """Return what a planner reads of a costmap, with the inflated cells of the C++ run."""
    inputs = scenario.inputs
    return SimpleNamespace(
        cells=scenario.array("costmap"),
        origin=inputs["origin"],
        resolution=inputs["resolution"],
        footprint=np.array(inputs["footprint"], dtype=np.float64).reshape(-1, 2),
    )


def make_planner(scenario):
    """Return a planner with the parameters of a scenario."""
    ros = scenario.inputs["ros"]
    frequency = ros["controller_frequency"]
    period = 1.0 / frequency if frequency > 0 else 0.05
    return DWAPlanner(
        {**DEFAULTS, **scenario.inputs["params"]},
        period,
        ros["sum_scores"],
        ros["cheat_factor"],
    )


def flags_in(scenario):
    """Return the oscillation flags (15,) before the first cycle."""
    return scenario.inputs.get("flags_in", [0] * 15)


def dwa(scenario):
    """Compare one search: its command, flags, grids, and the critics of each sample."""
    inputs = scenario.inputs
    expected = scenario.expected
    costmap = make_costmap(scenario)
    planner = make_planner(scenario)
    planner.state = flags_in(scenario)
    choice = planner.find_best_path(
        costmap,
        scenario.array("plan"),
        inputs["pose"],
        inputs["vel"],
    )

    # The trajectory that won, the command, and the flags for the next cycle
    best = expected["best"]
    winner = (choice.cost, choice.vx, choice.vy, choice.w, choice.count, choice.sample)
    fields = ("cost", "xv", "yv", "thetav", "points", "index")
    yield "best", winner, [best[field] for field in fields]
    yield "drive", choice.drive, best["drive"]
    yield "best_traj", choice.points, scenario.array("best_traj").reshape(-1, 3)
    yield "flags_after", planner.state, expected["flags_after"]
    yield "scales", planner.scales[: len(expected["scales"])], expected["scales"]
    yield "pose_used, vel_used", planner.start, expected["pose_used"] + expected["vel_used"]
    for name, ours in zip(GRIDS, planner.grids()):
        yield name, ours, scenario.array(name)

    # Each sample by itself: a wrong score can hide behind a better sample.
    scores = planner.score_all_samples()
    yield "samples", scores.velocities, scenario.array("samples")
    yield "accepted", scores.counts > 0, scenario.array("accepted")
    yield "npoints", scores.counts, scenario.array("npoints")
    yield "end", scores.ends, scenario.array("end")
    yield "critics", scores.critics[:, :6], scenario.array("critics")
    yield "cost", scores.costs, scenario.array("cost")
    cuts = np.where(scores.ended == ALL, THROUGH, scores.ended)
    yield "cut", cuts, scenario.array("cut")
    if "stored" in scenario:
        yield "stored", scores.stored, scenario.array("stored")
    counts = [
        len(scores.counts),
        (scores.counts > 0).sum(),
        (scores.costs >= 0).sum(),
    ]
    expected_counts = [
        expected["count"],
        expected["accepted"],
        expected["legal"],
    ]
    yield "count, accepted, legal", counts, expected_counts


def rollout(scenario):
    """Compare the cycles of a roll-out. Each begins with the pose, velocity and flags of the C++
    run.
    """
    costmap = make_costmap(scenario)
    planner = make_planner(scenario)
    plan = scenario.array("plan")
    rows = scenario.array("rollout")  # x, y, yaw, commanded vx, vy and w, cost
    states = scenario.array("rollout_state")
    starts = scenario.array("rollout_used")
    expected = np.hstack([rows[:, 3:], scenario.array("rollout_best"), states, starts])
    cycles = []
    # The robot drives as it was commanded one cycle ago.
    velocity = scenario.inputs["vel"]
    state = flags_in(scenario)
    for row, state_after, expected_row in zip(rows, states, expected):
        planner.state = state
        choice = planner.find_best_path(costmap, plan, row[:3], velocity)
        winner = [choice.vx, choice.vy, choice.w, choice.count]
        if choice.cost < 0:
            winner = expected_row[4:8]  # C++ keeps the values of the previous winner.
        cycles.append([*choice.drive, choice.cost, *winner, *planner.state, *planner.start])
        velocity = row[3:6]
        state = state_after
    yield "commands, costs, winners, flags, poses used", np.array(cycles), expected


def drive(scenario):
    """Compare cutting, searching, stopping, turning and the goal test. Pose and velocity of every
    step are given.
    """
    inputs = scenario.inputs
    costmap = make_costmap(scenario)
    planner = DWALocalPlanner({**DEFAULTS, **inputs["params"], **inputs["ros"]})
    planner.set_plan(scenario.array("global_plan"))
    yield "goal_yaw_used", planner.stored_plan.goal()[2], scenario.expected["goal_yaw_used"]
    planner.planner.state = flags_in(scenario)
    latched, rotating = inputs.get("lsr_in", [0, 0])
    planner.stop_rotate.latched = bool(latched)
    planner.stop_rotate.rotating = bool(rotating)
    expected = scenario.array("steps_out")
    replan_every = inputs.get("replan_every", 0)
    steps = []
    states = []
    for index, row in enumerate(scenario.array("steps_in")):
        pose = tuple(row[:3].tolist())
        velocity = tuple(row[3:].tolist())
        if replan_every and index and index % replan_every == 0:
            planner.set_plan(scenario.array("global_plan"))
        reached = planner.is_goal_reached(pose, velocity)
        step = planner.command(pose, velocity, costmap)

        phase = PHASES.index(step.phase)
        plan_lengths = (len(step.cut), len(planner.stored_plan.poses))
        point_count = step.point_count
        if step.phase == DRIVING and not step.ok:
            point_count = expected[index, 11]  # C++ keeps the number of the previous winner.
        # While it stops or turns, C++ checks one trajectory instead of searching.
        is_checked = step.phase in (STOPPING, TURNING)
        checked = (*np.float32(step.checked), is_checked and step.ok)
        steps.append(
            [
                *(reached, phase > 0, *plan_lengths, phase > 1, phase, step.ok),
                *(*step.command, step.cost, point_count, *checked),
                *(planner.stop_rotate.latched, planner.stop_rotate.rotating),
            ]
        )
        states.append(planner.planner.state)
    yield "steps", np.array(steps, dtype=np.float64), expected
    yield "flags", states, scenario.array("steps_state")


def local_plan(scenario, frame=None, tolerance=0.0):
    """Compare the plans that a cut leaves at some poses, one after the other; cutting prunes the
    stored plan.

    Args:
        scenario: Scenario with a plan, and poses at which it is cut.
        frame: Pose (x, y, yaw) of the plan's frame in the odometry frame, None if it is the same.
        tolerance: Largest allowed difference of cut points [m, rad].
    """
    inputs = scenario.inputs
    half_size = max(cells * inputs["resolution"] / 2.0 for cells in inputs["size"])
    plan = LocalPlan()
    plan.store(scenario.array("global_plan"))
    if "goal_yaw_used" in scenario.expected:
        yield "goal_yaw_used", plan.goal(frame)[2], scenario.expected["goal_yaw_used"], tolerance
    cuts = []
    results = []
    for x, y, _ in scenario.array("poses").tolist():
        has_plan = len(plan.poses) > 0
        cut = plan.cut(x, y, half_size, bool(inputs["prune_plan"]), frame)
        cuts.append(cut)
        results.append((has_plan, len(cut), len(plan.poses)))
    yield "result", results, scenario.array("result")
    yield "local_plans", np.vstack(cuts), scenario.array("local_plans").reshape(-1, 3), tolerance


def local_plan_tf(scenario):
    """Compare the cuts of a plan in another frame."""
    yield from local_plan(scenario, scenario.inputs["plan_frame_to_odom"], ANOTHER_FRAME)


KINDS = dict(dwa=dwa, dwa_edge=dwa, rollout=rollout, drive=drive, stop_rotate=drive)
KINDS.update(local_plan=local_plan, local_plan_tf=local_plan_tf)
