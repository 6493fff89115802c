"""Replay of the DWA planner's golden scenarios (format planner-golden-2-dwa), one function per kind
of scenario.

Used by replay_golden.py. Each function yields (quantity, ours, expected), and a tolerance if the
numbers cannot match to the last bit.
"""

from types import SimpleNamespace

import numpy as np

from applr_ros1.planner.dwa.critics import ALL
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
GRIDS = ("path_dist", "goal_dist", "goal_front_dist", "alignment_dist")
PHASES = (NO_PLAN, DRIVING, STOPPING, TURNING, TURNED)
THROUGH = 255  # value in `cut` if the search scored a sample with all critics
ANOTHER_FRAME = 1e-9  # tolerance of poses transformed from another frame [m, rad]

# Defaults for the parameters that C++ does not have
DEFAULTS = {p.name: p.default for p in DWA_PLANNER}


def make_costmap(scenario):
    given = scenario.inputs
    return SimpleNamespace(
        cells=scenario.array("costmap"),
        origin=given["origin"],
        resolution=given["resolution"],
        footprint=np.array(given["footprint"], dtype=np.float64).reshape(-1, 2),
    )


def make_planner(scenario):
    ros = scenario.inputs["ros"]
    frequency = ros["controller_frequency"]
    period = 1.0 / frequency if frequency > 0 else 0.05
    return DWAPlanner(
        {**DEFAULTS, **scenario.inputs["params"]}, period, ros["sum_scores"], ros["cheat_factor"]
    )


def flags_in(scenario):
    return scenario.inputs.get("flags_in", [0] * 15)


def dwa(scenario):
    given = scenario.inputs
    expected = scenario.expected
    costmap = make_costmap(scenario)
    planner = make_planner(scenario)
    planner.state = flags_in(scenario)
    choice = planner.find_best_path(costmap, scenario.array("plan"), given["pose"], given["vel"])
    best = expected["best"]
    yield (
        "best",
        (choice.cost, choice.vx, choice.vy, choice.w, choice.count, choice.sample),
        [best[name] for name in ("cost", "xv", "yv", "thetav", "points", "index")],
    )
    yield "drive", choice.drive, best["drive"]
    yield "best_traj", choice.points, scenario.array("best_traj").reshape(-1, 3)
    yield "flags_after", planner.state, expected["flags_after"]
    yield "scales", planner.scales[: len(expected["scales"])], expected["scales"]
    yield "pose_used, vel_used", planner.start, expected["pose_used"] + expected["vel_used"]
    for name, ours in zip(GRIDS, planner.grids()):
        yield name, ours, scenario.array(name)
    every = planner.score_all_samples()
    yield "samples", every.velocities, scenario.array("samples")
    yield "accepted", every.counts > 0, scenario.array("accepted")
    yield "npoints", every.counts, scenario.array("npoints")
    yield "end", every.ends, scenario.array("end")
    yield "critics", every.critics[:, :6], scenario.array("critics")
    yield "cost", every.costs, scenario.array("cost")
    yield "cut", np.where(every.ended == ALL, THROUGH, every.ended), scenario.array("cut")
    if "stored" in scenario:
        yield "stored", every.stored, scenario.array("stored")
    counts = [len(every.counts), (every.counts > 0).sum(), (every.costs >= 0).sum()]
    yield (
        "count, accepted, legal",
        counts,
        [expected[name] for name in ("count", "accepted", "legal")],
    )


def rollout(scenario):
    """Compare the cycles of a roll-out. Each begins with the pose, velocity and flags of the C++
    run.
    """
    given = scenario.inputs
    costmap = make_costmap(scenario)
    planner = make_planner(scenario)
    plan = scenario.array("plan")
    rows = scenario.array("rollout")
    states = scenario.array("rollout_state")
    wanted = np.hstack(
        [rows[:, 3:], scenario.array("rollout_best"), states, scenario.array("rollout_used")]
    )
    ours = []
    for index, row in enumerate(rows):
        planner.state = states[index - 1] if index else flags_in(scenario)
        velocity = rows[index - 1, 3:6] if index else given["vel"]
        choice = planner.find_best_path(costmap, plan, row[:3], velocity)
        winner = [choice.vx, choice.vy, choice.w, choice.count]
        if choice.cost < 0:
            winner = wanted[index, 4:8]  # C++ keeps the values of the previous winner.
        ours.append([*choice.drive, choice.cost, *winner, *planner.state, *planner.start])
    yield "commands, costs, winners, flags, poses used", np.array(ours), wanted


def drive(scenario):
    """Compare cutting, searching, stopping, turning and the goal test. Pose and velocity of every
    step are given.
    """
    given = scenario.inputs
    costmap = make_costmap(scenario)
    planner = DWALocalPlanner({**DEFAULTS, **given["params"], **given["ros"]})
    planner.set_plan(scenario.array("global_plan"))
    yield "goal_yaw_used", planner.stored_plan.goal()[2], scenario.expected["goal_yaw_used"]
    planner.planner.state = flags_in(scenario)
    planner.stop_rotate.latched, planner.stop_rotate.rotating = map(
        bool, given.get("lsr_in", [0, 0])
    )
    wanted = scenario.array("steps_out")
    every = given.get("replan_every", 0)
    ours = []
    states = []
    for index, row in enumerate(scenario.array("steps_in")):
        pose = tuple(row[:3].tolist())
        velocity = tuple(row[3:].tolist())
        if every and index and index % every == 0:
            planner.set_plan(scenario.array("global_plan"))
        reached = planner.is_goal_reached(pose, velocity)
        step = planner.command(pose, velocity, costmap)
        phase = PHASES.index(step.phase)
        # C++: previous winner
        count = wanted[index, 11] if phase == 1 and not step.ok else step.point_count
        checked = phase in (2, 3)
        ours.append(
            [
                reached,
                phase > 0,
                len(step.cut),
                len(planner.stored_plan.poses),
                phase > 1,
                phase,
                step.ok,
            ]
            + [*step.command, step.cost, count, *np.float32(step.checked), checked and step.ok]
            + [planner.stop_rotate.latched, planner.stop_rotate.rotating]
        )
        states.append(planner.planner.state)
    yield "steps", np.array(ours, dtype=np.float64), wanted
    yield "flags", states, scenario.array("steps_state")


def local_plan(scenario, frame=None, tolerance=0.0):
    given = scenario.inputs
    limit = max(n * given["resolution"] / 2.0 for n in given["size"])
    plan = LocalPlan()
    plan.set(scenario.array("global_plan"))
    if "goal_yaw_used" in scenario.expected:
        yield "goal_yaw_used", plan.goal(frame)[2], scenario.expected["goal_yaw_used"], tolerance
    cuts = []
    results = []
    for x, y, _ in scenario.array("poses").tolist():
        stored = len(plan.poses)
        cut = plan.cut(x, y, limit, bool(given["prune_plan"]), frame)
        cuts.append(cut)
        results.append((stored > 0, len(cut), len(plan.poses)))
    yield "result", results, scenario.array("result")
    yield "local_plans", np.vstack(cuts), scenario.array("local_plans").reshape(-1, 3), tolerance


def local_plan_tf(scenario):
    yield from local_plan(scenario, scenario.inputs["plan_frame_to_odom"], ANOTHER_FRAME)


KINDS = dict(dwa=dwa, dwa_edge=dwa, rollout=rollout, drive=drive, stop_rotate=drive)
KINDS.update(local_plan=local_plan, local_plan_tf=local_plan_tf)
