"""Replay of the golden vectors of the C++ planner with this package's planner, for test_golden.py.

tests/golden/FORMAT.md and tests/golden_dwa/FORMAT_DWA.md document the formats. Each set of
scenarios names its format. replay_dwa.py replays the scenarios in the format of FORMAT_DWA.md.
"""

import hashlib
import json
from pathlib import Path

import numpy as np

from applr_ros1.planner.costmap.footprint import pad, radii
from applr_ros1.planner.costmap.inflation_layer import InflationParameters
from applr_ros1.planner.navfn.navfn import LIST_SIZE, Navfn
from applr_ros1.planner.sampling_planner import start_record
from applr_ros1.planner.trajectory.planner import TrajectoryPlanner
from applr_ros1.planner.trajectory.sampling import fill_evenly, velocity_window
from tests.planner import replay_dwa
from tests.support.scenes import laser_costmap, paint

# Format of tests/golden, as in its manifest.json.
FORMAT = "planner-golden-1"
# Ranges and steps of the sampled velocities, as the C++ planner names them.
WINDOW = ("min_vel_x", "max_vel_x", "min_vel_theta", "max_vel_theta", "dvx", "dvtheta")
# First five values of the planner's state, in its order.
FLAGS = ("stuck_left", "stuck_right", "rotating_left", "rotating_right", "escaping")


class Scenario:
    """One scenario of a set, with its JSON fields and its arrays by name."""

    def __init__(self, fields, arrays):
        self.id = fields["id"]
        self.kind = fields["kind"]
        self.inputs = fields["inputs"]
        self.expected = fields["expected"]
        self.robot = fields.get("meta", {}).get("robot", "")
        self._names = fields.get("arrays", ())
        self._arrays = arrays

    def __contains__(self, name):
        return name in self._names

    def array(self, name):
        return np.ascontiguousarray(self._arrays["%s/%s" % (self.id, name)])


def load(folder):
    """Return the scenarios of the set in `folder`."""
    content = json.loads((Path(folder) / "manifest.json").read_text(encoding="utf-8"))
    arrays = np.load(Path(folder) / "arrays.npz", allow_pickle=False)
    scenarios = [Scenario(fields, arrays) for fields in content["scenarios"]]
    for scenario in scenarios:
        scenario.compare = FORMATS[content["format"]][scenario.kind]
    return scenarios


# The function for each kind of scenario yields (quantity, ours, expected) for every comparable
# quantity.


def sampled_window(planner, plan):
    """Return ranges and steps of a TrajectoryPlanner's last samples along a plan: {"min_vel_x",
    "max_vel_x", "dvx", ...}.
    """
    in_force = planner.in_force
    plan_points = np.ascontiguousarray(plan[:, :2])
    slowest, fastest, lowest_turn, highest_turn = velocity_window(
        in_force, plan_points, start_record(planner.start)
    )
    speed_step = fill_evenly(slowest, fastest, np.zeros(in_force["vx_samples"]))
    turn_step = fill_evenly(lowest_turn, highest_turn, np.zeros(in_force["vtheta_samples"]))
    return {
        "min_vel_x": slowest,
        "max_vel_x": fastest,
        "dvx": speed_step,
        "min_vel_theta": lowest_turn,
        "max_vel_theta": highest_turn,
        "dvtheta": turn_step,
    }


def make_costmap(scenario):
    """Return the costmap of a scenario, inflated by this package's layer."""
    inputs = scenario.inputs
    columns, rows = inputs["size"]
    resolution = inputs["resolution"]
    inflation_parameters = InflationParameters(
        inputs["inflation_radius"],
        inputs["cost_scaling_factor"],
        True,
        bool(inputs["inflate_unknown"]),
    )
    # Costmap divides the size by the resolution and rounds down. Half a cell more keeps a rounding
    # error from taking a column.
    costmap = laser_costmap(
        (columns + 0.5) * resolution,
        (rows + 0.5) * resolution,
        resolution,
        inputs["origin"],
        footprint=pad(inputs["footprint"], inputs["footprint_padding"]),
        track_unknown=bool(inputs["track_unknown"]),
        inflation=inflation_parameters,
    )
    paint(costmap, scenario.array("cells"))
    return costmap


def compare_costmap(scenario, costmap):
    """Compare the costs of the cells, and the radii [m] of the footprint that they come from."""
    if "costmap" in scenario:
        yield "costmap", costmap.cells, scenario.array("costmap")
    for name, radius in zip(("inscribed_radius", "circumscribed_radius"), radii(costmap.footprint)):
        if name in scenario.expected:
            yield name, radius, scenario.expected[name]


def inflation(scenario):
    """Compare the inflated costmap alone."""
    yield from compare_costmap(scenario, make_costmap(scenario))


def navfn(scenario):
    """Compare the global plan, and the potential that it descends."""
    inputs = scenario.inputs
    expected = scenario.expected
    costmap = make_costmap(scenario)
    yield from compare_costmap(scenario, costmap)
    planner = Navfn(inputs.get("list_size", LIST_SIZE))
    start_x, start_y, goal_x, goal_y = inputs["nav"]
    plan = planner.plan(
        costmap,
        (start_x, start_y),
        (goal_x, goal_y, 0.0),
        inputs.get("tolerance", 0.0),
        bool(inputs["allow_unknown"]),
    )
    if expected.get("navfn") is None:
        yield "plan", len(plan), 0
        return
    yield "plan", plan[:, :2], scenario.array("plan_navfn").reshape(-1, 2)
    potential = planner.potential
    if "potential" in scenario:
        yield "potential", potential, scenario.array("potential")
    # Of a large map the set has every fourth cell, a patch with all cells, and a hash of the whole.
    if "potential_stride4" in scenario:
        x, y = expected["patch_origin"]
        patch = scenario.array("potential_patch")
        height, width = patch.shape
        yield "potential_stride4", potential[::4, ::4], scenario.array("potential_stride4")
        yield "potential_patch", potential[y : y + height, x : x + width], patch
    hashed = {"potential_sha256": potential.astype("<f4"), "costarr_sha256": planner.costs}
    for name, array in hashed.items():
        if name in expected:
            digest = hashlib.sha256(np.ascontiguousarray(array).tobytes()).hexdigest()
            yield name, int(digest == expected[name]), 1


def make_planner(scenario, costmap):
    """Return a planner with the parameters of a scenario."""
    inputs = scenario.inputs
    return TrajectoryPlanner(
        costmap.footprint,
        inputs["params"],
        inputs["sim_period"],
        bool(inputs["meter_scoring"]),
    )


def dwa(scenario):
    """Compare one control cycle: its command, state, grids, and the score of each sample."""
    inputs = scenario.inputs
    expected = scenario.expected
    costmap = make_costmap(scenario)
    yield from compare_costmap(scenario, costmap)
    planner = make_planner(scenario, costmap)
    planner.set_plan(scenario.array("plan"))
    planner.state = inputs.get("flags_in", [0] * 10)
    result = planner.find_best_path(costmap, inputs["pose"], inputs["vel"])

    # The trajectory that won, the command, and the state for the next cycle.
    best = expected["best"]
    winner = (result.cost, result.vx, 0, result.w, result.count)
    yield "best", winner, [best[name] for name in ("cost", "xv", "yv", "thetav", "points")]
    yield "drive", result.drive, best["drive"]
    yield "best_traj", result.points, scenario.array("best_traj").reshape(-1, 3)
    yield "state_after", planner.state, expected["state_after"]
    yield "flags_after", planner.state[:5], [expected["flags_after"][name] for name in FLAGS]

    # The weights in force, after C++'s scaling by the resolution.
    weights = expected["effective"]
    scaled = {"path_distance_bias": "path_scale", "goal_distance_bias": "goal_scale"}
    in_force = [planner.in_force[scaled.get(name, name)].item() for name in weights]
    yield "effective", in_force, list(weights.values())
    if not expected.get("has_samples", True):
        return

    # The start of the simulated trajectories, and the velocities that are sampled.
    used = list(expected["pose_used"]) + list(expected["vel_used"])
    yield "pose_used, vel_used", planner.start, used
    yield "footprint_cost_here", costmap.footprint_cost(*used[:3]), expected["footprint_cost_here"]
    window = expected["window"]
    # Null if C++ divided by zero.
    names = [name for name in WINDOW if window[name] is not None]
    ours = sampled_window(planner, scenario.array("plan"))
    yield "window", [ours[name] for name in names], [window[name] for name in names]

    # Each sample by itself: a wrong score can hide behind a better sample.
    yield from compare_grids(scenario, planner)
    rows = scenario.array("samples")
    scored = [planner.score(costmap, used[:3], used[3:], row[:3]) for row in rows]
    yield "samples", np.array(scored).reshape(-1, 5), rows[:, 3:]


def compare_grids(scenario, planner):
    """Compare the grids of distances to path and goal, and the local goal."""
    for name, ours in zip(("path_dist", "goal_dist", "within_robot"), planner.grids()):
        yield name, ours, scenario.array(name)
        if name == "goal_dist" and "local_goal" in scenario.expected:
            centre = local_goal(scenario.inputs, ours)
            yield "local_goal", centre, scenario.expected["local_goal"] or []


def local_goal(inputs, goal_distance):
    """Return the centre (x, y) [m] of the first cell with goal distance 0, or [] without one."""
    goal_cells = np.argwhere(goal_distance == 0)
    if len(goal_cells) == 0:
        return []
    row, column = goal_cells[0]
    origin_x, origin_y = inputs["origin"]
    resolution = inputs["resolution"]
    return [origin_x + (column + 0.5) * resolution, origin_y + (row + 0.5) * resolution]


def rollout(scenario):
    """Compare each control cycle of a drive with C++, starting from the pose, velocity and state of
    the C++ run.
    """
    costmap = make_costmap(scenario)
    yield from compare_costmap(scenario, costmap)
    planner = make_planner(scenario, costmap)
    planner.set_plan(scenario.array("plan"))
    rows = scenario.array("rollout")  # x, y, yaw, commanded v and w, cost
    states = scenario.array("rollout_state")
    starts = scenario.array("rollout_used")
    expected = np.hstack([rows[:, 3:6], scenario.array("rollout_best"), states, starts])
    cycles = []
    # The robot drives as it was commanded one cycle ago.
    velocity = scenario.inputs["vel"]
    state = [0] * 10
    for row, state_after in zip(rows, states):
        planner.state = state
        result = planner.find_best_path(costmap, row[:3], velocity)
        winner = (result.cost, result.vx, result.w, result.count)
        cycles.append([*result.drive[::2], *winner, *planner.state, *planner.start])
        velocity = (row[3], 0.0, row[4])
        state = state_after
    ours = np.array(cycles).reshape(-1, 22)
    yield "commands, costs, winners, states, poses used", ours, expected


FORMATS = {
    FORMAT: {
        "dwa": dwa,
        "dwa_edge": dwa,
        "inflation": inflation,
        "navfn": navfn,
        "rollout": rollout,
    },
    replay_dwa.FORMAT: replay_dwa.KINDS,
}


def difference(ours, expected):
    """Return the largest absolute difference, or infinity if the shapes differ or only one value is
    a number.
    """
    ours = np.asarray(ours, dtype=np.float64)
    expected = np.asarray(expected, dtype=np.float64)
    if ours.shape != expected.shape:
        return np.inf
    # Equal infinities are no difference, although their difference is not a number.
    unequal = (ours != expected) & ~(np.isnan(ours) & np.isnan(expected))
    if not unequal.any():
        return 0.0
    largest = np.max(np.abs(ours[unequal] - expected[unequal]))
    return np.inf if np.isnan(largest) else float(largest)


def replay(scenario):
    """Return {quantity: largest difference} for all quantities that differ in the scenario."""
    differences = {}
    for quantity, ours, expected, *tolerance in scenario.compare(scenario):
        largest = difference(ours, expected)
        # Without a tolerance, equal means bit for bit.
        if largest > (tolerance[0] if tolerance else 0.0):
            differences[quantity] = largest
    return differences
