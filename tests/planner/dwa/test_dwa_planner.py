"""The DWA planner: its short cuts choose what scoring every sample chooses; parameters, memory, single velocities."""

import numpy as np

from applr_ros1 import robots
from applr_ros1.planner.dwa.planner import DWAPlanner
from applr_ros1.planner.parameters.check import complete
from tests import replay_golden
from tests.support import ROOT
from tests.support.map_scenes import open_map

BURGER_FOOT = np.array([[-0.115, -0.115], [-0.115, 0.115], [0.051, 0.115], [0.051, -0.115]])
BURGER = dict(complete(robots.load("turtlebot3_burger").parameters())["DWAPlannerROS"], vy_samples=1)


def small_map():
    return open_map(60, 60, origin=(-1.5, -1.5), foot=BURGER_FOOT)


def random_parameters(random):
    def one(*values):
        return float(random.choice(values))

    holonomic = random.random() < 0.3
    fastest = one(0.22, 0.5, 1.0, 2.0)
    return dict(
        BURGER,
        max_vel_trans=fastest * one(1, 1, 0.7, 1.2),
        min_vel_trans=one(0, 0.05, 0.11),
        max_vel_x=fastest,
        min_vel_x=one(0, 0, -0.2, 0.1),
        max_vel_y=one(0.1, 0.3) if holonomic else 0.0,
        min_vel_y=one(-0.1, 0.0) if holonomic else 0.0,
        max_vel_theta=one(0, 0.5, 1.57, 2.75),
        min_vel_theta=one(0, 0.3, 1.37),
        acc_lim_x=one(10, 2.5, 0.3, 0),
        acc_lim_y=one(2.5, 0.3),
        acc_lim_theta=one(20, 3.2, 0.5),
        sim_time=one(0.5, 1.5, 2, 4),
        sim_granularity=one(0.025, 0.1),
        angular_sim_granularity=one(0.025, 0.1, 0.7),
        path_distance_bias=one(0, 0.6, 32),
        goal_distance_bias=one(0, 0.8, 20),
        occdist_scale=one(0, 0.01, 0.02, 0.1, 1),
        twirling_scale=one(0, 0, 0.5),
        forward_point_distance=one(0, 0.1, 0.325, -0.2),
        scaling_speed=one(0.25, 0),
        max_scaling_factor=one(0.2, 1),
        vx_samples=int(random.integers(1, 7)),
        vy_samples=int(random.integers(1, 4)),
        vth_samples=int(random.integers(1, 14)),
        use_dwa=bool(random.random() < 0.8),
    )


def test_chooses_as_scoring_every_sample():
    """Winner, cost and flags, on random maps, plans, poses, velocities, footprints, parameters and flags."""
    legal = 0
    scenarios = [scenario for scenario in replay_golden.load(ROOT / "tests/golden_drawn") if scenario.kind == "dwa"]
    for seed, scenario in enumerate(2 * scenarios):
        random = np.random.default_rng(seed)
        costmap, plan = replay_golden.make_costmap(scenario), scenario.array("plan")
        pose = np.array(scenario.inputs["pose"])
        if random.random() < 0.3:  # far from the origin float32 steps are coarse
            far = random.choice([-700.0, 40.0, 5000.0])
            costmap.origin[:] += far
            pose[:2] += far
        planner = DWAPlanner(random_parameters(random), 0.1, bool(random.random() < 0.2))
        flags = [int(v) for v in random.integers(0, 2, 12) * (random.random() < 0.3)]
        planner.state = flags + (pose + random.normal(0, 0.05, 3)).astype(np.float32).tolist()
        velocity = (random.choice([0, 0.2, 0.5, -0.1]), random.choice([0, 0, 0.1]), random.uniform(-2, 2))
        for _ in range(2):  # the second time with the flags and the older plan of the first
            before = planner.state
            choice = planner.find_best_path(costmap, plan, pose, velocity)
            every = planner.score_all_samples()
            ranked = np.where(every.costs >= 0, every.costs, np.inf)
            best = int(np.argmin(ranked))
            if not np.isfinite(ranked[best]):
                assert (choice.cost, choice.sample, choice.drive) == (-7.0, -1, (0.0, 0.0, 0.0)), seed
                assert planner.state == before
                continue
            legal += 1
            assert (choice.cost, choice.sample, choice.count) == (every.costs[best], best, every.counts[best]), seed
            assert [choice.vx, choice.vy, choice.w] == every.stored[best].tolist(), seed
            assert choice.points[-1].tolist() == every.ends[best].tolist(), seed
            assert min(every.shown[every.shown >= 0]) == choice.cost
    assert legal > 250


def test_a_changed_footprint_counts_at_once():
    planner, costmap, plan = DWAPlanner(BURGER, 0.1), small_map(), [(0, 0), (1, 0)]
    costmap.cells[34, 30] = 254  # beside the robot, under the outline of one twice as large
    assert planner.find_best_path(costmap, plan, (0, 0, 0), (0, 0, 0)).cost >= 0
    costmap.footprint = BURGER_FOOT * 2
    assert planner.find_best_path(costmap, plan, (0, 0, 0), (0, 0, 0)).cost == -7


def test_says_which_critic_refused_how_many_samples():
    """A turn that was just driven the other way; a box around the robot; a limit that no speed keeps."""
    forward = dict(BURGER, min_vel_x=0.15, vx_samples=2, vth_samples=3)
    planner, costmap, plan = DWAPlanner(forward, 0.1), small_map(), [(0, 0), (1, 0)]
    planner.state = [0] * 4 + [1] + [0] * 10  # only turns to the left
    planner.find_best_path(costmap, plan, (0, 0, 0), (0.15, 0, 0))
    found = planner.refusals()
    assert (found.pop("samples"), found.pop("oscillation")) == (6, 2)
    assert not any(found.values())
    costmap.cells[:, 33:35] = 254
    planner.find_best_path(costmap, plan, (0, 0, 0), (0.15, 0, 0))
    found = planner.refusals()
    assert (found["oscillation"], found["obstacle"], sum(found.values())) == (2, 4, 12)
    planner.reconfigure({"max_vel_trans": 0.01})
    planner.find_best_path(costmap, plan, (0, 0, 0), (0.15, 0, 0))
    assert planner.refusals() == {**dict.fromkeys(found, 0), "samples": 6, "velocity limits": 6}


def test_reset_is_a_new_object():
    costmap, plan = small_map(), [(0, 0), (1, 0.3)]
    planner = DWAPlanner(BURGER, 0.1)
    first = planner.find_best_path(costmap, plan, (0, 0, 0), (0, 0, 0))
    for x in (0.1, 0.2, 0.9):
        planner.find_best_path(costmap, plan, (x, 0, 0), (-0.1, 0, 0.4))
    planner.reset()
    planner.prepare(costmap, plan, (0, 0, 0), (0, 0, 0))
    assert planner.check((0.2, 0, 0))[0] > 1e300  # the grids count as never flooded
    again = planner.find_best_path(costmap, plan, (0, 0, 0), (0, 0, 0))
    assert (again.cost, again.sample, planner.state) == (first.cost, first.sample, planner.state)
