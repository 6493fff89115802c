"""Replay of the golden vectors of the C++ planner with this package's planner, for test_golden.py.

tests/golden/FORMAT.md and tests/golden_dwa/FORMAT_DWA.md document the formats. Each set of
scenarios names its format. replay_dwa.py replays the scenarios in the format of FORMAT_DWA.md.
"""

import hashlib
import json
from pathlib import Path

import numpy as np

from applr_ros1.planner.costmap.costmap import Costmap
from applr_ros1.planner.costmap.footprint import pad, radii
from applr_ros1.planner.costmap.inflation_layer import InflationParameters
from applr_ros1.planner.navfn.navfn import LIST_SIZE, Navfn
from applr_ros1.planner.trajectory.planner import TrajectoryPlanner
from applr_ros1.planner.trajectory.sampling import fill_evenly, velocity_window
from tests.planner import replay_dwa
from tests.support.scenes import paint

FORMAT = "planner-golden-1"
WINDOW = ("min_vel_x", "max_vel_x", "min_vel_theta", "max_vel_theta", "dvx", "dvtheta")
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


def sampled_window(planner):
    """Return ranges and steps of a TrajectoryPlanner's last samples: {"min_vel_x", "max_vel_x",
    "dvx", ...}.
    """
    x0, x1, w0, w1 = velocity_window(planner.in_force, planner._plan, planner._scratch.start[0])
    dvx = fill_evenly(x0, x1, planner._scratch.vs)
    dw = fill_evenly(w0, w1, planner._scratch.ws)
    names = "min_vel_x", "max_vel_x", "dvx", "min_vel_theta", "max_vel_theta", "dvtheta"
    return dict(zip(names, (x0, x1, dvx, w0, w1, dw)))


def make_costmap(scenario):
    """Return the costmap of a scenario, inflated by this package's layer."""
    given = scenario.inputs
    nx, ny = given["size"]
    resolution = given["resolution"]
    costmap = Costmap(
        (nx + 0.5) * resolution,
        (ny + 0.5) * resolution,
        resolution,
        given["origin"],
        footprint=pad(given["footprint"], given["footprint_padding"]),
        track_unknown=bool(given["track_unknown"]),
        inflation=InflationParameters(
            given["inflation_radius"],
            given["cost_scaling_factor"],
            True,
            bool(given["inflate_unknown"]),
        ),
    )
    paint(costmap, scenario.array("cells"))
    return costmap


def compare_costmap(scenario, costmap):
    if "costmap" in scenario:
        yield "costmap", costmap.cells, scenario.array("costmap")
    for name, radius in zip(("inscribed_radius", "circumscribed_radius"), radii(costmap.footprint)):
        if name in scenario.expected:
            yield name, radius, scenario.expected[name]


def inflation(scenario):
    yield from compare_costmap(scenario, make_costmap(scenario))


def navfn(scenario):
    given = scenario.inputs
    expected = scenario.expected
    costmap = make_costmap(scenario)
    yield from compare_costmap(scenario, costmap)
    planner = Navfn(given.get("list_size", LIST_SIZE))
    sx, sy, gx, gy = given["nav"]
    tolerance = given.get("tolerance", 0.0)
    plan = planner.plan(costmap, (sx, sy), (gx, gy, 0.0), tolerance, bool(given["allow_unknown"]))
    if expected.get("navfn") is None:
        yield "plan", len(plan), 0
        return
    yield "plan", plan[:, :2], scenario.array("plan_navfn").reshape(-1, 2)
    potential = planner.potential
    if "potential" in scenario:
        yield "potential", potential, scenario.array("potential")
    if "potential_stride4" in scenario:
        x, y = expected["patch_origin"]
        patch = scenario.array("potential_patch")
        yield "potential_stride4", potential[::4, ::4], scenario.array("potential_stride4")
        yield "potential_patch", potential[y : y + patch.shape[0], x : x + patch.shape[1]], patch
    for name, array in (
        ("potential_sha256", potential.astype("<f4")),
        ("costarr_sha256", planner.costs),
    ):
        if name in expected:
            same = (
                hashlib.sha256(np.ascontiguousarray(array).tobytes()).hexdigest() == expected[name]
            )
            yield name, int(same), 1


def make_planner(scenario, costmap):
    given = scenario.inputs
    return TrajectoryPlanner(
        costmap.footprint, given["params"], given["sim_period"], bool(given["meter_scoring"])
    )


def dwa(scenario):
    given = scenario.inputs
    expected = scenario.expected
    costmap = make_costmap(scenario)
    yield from compare_costmap(scenario, costmap)
    planner = make_planner(scenario, costmap)
    planner.set_plan(scenario.array("plan"))
    planner.state = given.get("flags_in", [0] * 10)
    result = planner.find_best_path(costmap, given["pose"], given["vel"])
    best = expected["best"]
    yield (
        "best",
        (result.cost, result.vx, 0, result.w, result.count),
        [best[name] for name in ("cost", "xv", "yv", "thetav", "points")],
    )
    yield "drive", result.drive, best["drive"]
    yield "best_traj", result.points, scenario.array("best_traj").reshape(-1, 3)
    yield "state_after", planner.state, expected["state_after"]
    yield "flags_after", planner.state[:5], [expected["flags_after"][name] for name in FLAGS]
    weights = expected["effective"]
    yield (
        "effective",
        [planner.in_force[name].item() for name in sorted(weights)],
        [weights[w] for w in sorted(weights)],
    )
    if not expected.get("has_samples", True):
        return
    used = list(expected["pose_used"]) + list(expected["vel_used"])
    yield "pose_used, vel_used", planner.start, used
    yield "footprint_cost_here", costmap.footprint_cost(*used[:3]), expected["footprint_cost_here"]
    window = expected["window"]
    # Null if C++ divided by zero.
    names = [name for name in WINDOW if window[name] is not None]
    ours = sampled_window(planner)
    yield "window", [ours[name] for name in names], [window[name] for name in names]
    yield from compare_grids(scenario, planner)
    rows = scenario.array("samples")
    scored = [planner.score(costmap, used[:3], used[3:], row[:3]) for row in rows]
    yield "samples", np.array(scored).reshape(-1, 5), rows[:, 3:]


def compare_grids(scenario, planner):
    for name, ours in zip(("path_dist", "goal_dist", "within_robot"), planner.grids()):
        yield name, ours, scenario.array(name)
        if name == "goal_dist" and "local_goal" in scenario.expected:
            yield (
                "local_goal",
                local_goal(scenario.inputs, ours),
                scenario.expected["local_goal"] or [],
            )


def local_goal(given, goal_dist):
    """Return the centre [m] of the cell with goal distance 0, or [] if there is none."""
    return [
        given["origin"][index] + (cell[1 - index] + 0.5) * given["resolution"]
        for cell in np.argwhere(goal_dist == 0)[:1]
        for index in range(2)
    ]


def rollout(scenario):
    """Compare each control cycle of a drive with C++, starting from the pose, velocity and state of
    the C++ run.
    """
    given = scenario.inputs
    costmap = make_costmap(scenario)
    yield from compare_costmap(scenario, costmap)
    planner = make_planner(scenario, costmap)
    planner.set_plan(scenario.array("plan"))
    rows, states, used = (
        scenario.array(name) for name in ("rollout", "rollout_state", "rollout_used")
    )
    wanted = np.hstack([rows[:, 3:6], scenario.array("rollout_best"), states, used])
    ours = []
    for index, row in enumerate(rows):
        velocity = (rows[index - 1, 3], 0.0, rows[index - 1, 4]) if index else given["vel"]
        planner.state = states[index - 1] if index else [0] * 10
        result = planner.find_best_path(costmap, row[:3], velocity)
        ours.append(
            [
                *result.drive[::2],
                result.cost,
                result.vx,
                result.w,
                result.count,
                *planner.state,
                *planner.start,
            ]
        )
    yield "commands, costs, winners, states, poses used", np.array(ours).reshape(-1, 22), wanted


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
    a = np.asarray(ours, dtype=np.float64)
    b = np.asarray(expected, dtype=np.float64)
    if a.shape != b.shape:
        return np.inf
    unequal = (a != b) & ~(np.isnan(a) & np.isnan(b))
    if not unequal.any():
        return 0.0
    worst = np.max(np.abs(a[unequal] - b[unequal]))
    return np.inf if np.isnan(worst) else float(worst)


def replay(scenario):
    """Return {quantity: largest difference} for all quantities that differ in the scenario."""
    differences = {}
    for quantity, ours, expected, *tolerance in scenario.compare(scenario):
        worst = difference(ours, expected)
        if worst > (tolerance[0] if tolerance else 0.0):
            differences[quantity] = worst
    return differences
