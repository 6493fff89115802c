"""Tests that the unit of a planner's distance biases is detected from cost_cloud, and compensated
without effect.
"""

import json
from dataclasses import replace

import numpy as np

import worlds
from applr_ros1 import robots
from applr_ros1.nodes.applr.distance_weights import multipliers_of
from applr_ros1.nodes.applr.meter_scoring import factor_of
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.parameters.settings import send
from applr_ros1.policy import methods
from applr_ros1.policy.parameter_space import SPACE
from tests.support.robots import ToyRobot, quick, ring, run

# Upper bounds of TrajectoryPlannerROS for its biases.
LARGEST = np.full(len(SPACE), 5.0)


def tree(weights):
    tree = quick()
    tree["TrajectoryPlannerROS"] = dict(
        tree["TrajectoryPlannerROS"], meter_scoring=weights == "per_metre"
    )
    return tree


def cloud(weights, seed):
    """Return the MoveBase of a robot that has just set out among posts, its cost_cloud and its
    random parameters.
    """
    draw = np.random.default_rng(seed)
    move_base = MoveBase(tree(weights))
    robot = ToyRobot(circles=ring(0.0, 0.0, draw.uniform(1.0, 2.0), posts=int(draw.integers(0, 7))))
    theta = SPACE.to_theta(draw.uniform(-1.0, 1.0, len(SPACE)))
    send(SPACE.settings(theta), move_base)
    move_base.set_goal((*draw.uniform(-4.0, 4.0, 2), 0.0), 0.0)
    run(move_base, robot, 0.15)
    return move_base, move_base.local_planner.cost_cloud(move_base.local_costmap), theta


def test_the_unit_of_the_weights_is_detected_in_20_of_20_starts():
    for seed in range(20):
        unit = ("per_cell", "per_metre")[seed % 2]
        made, rows, theta = cloud(unit, seed)
        weights = theta[[5, 6, 4]]
        # C++ pads its clouds with zeros.
        cells = np.vstack([rows, np.zeros((500, 7), np.float32)])
        assert factor_of(cells, weights, 0.05) == {"per_cell": 1.0, "per_metre": 0.05}[unit]
        for k in range(2):  # The cloud is older than a change of the weights.
            assert factor_of(cells, weights * np.where(np.arange(3) == k, 1.1, 1.0), 0.05) is None
    # Five cells are too few.
    assert factor_of(np.vstack([rows[:5], cells[-500:]]), weights, 0.05) is None
    rows[:, 6] = weights[2] * rows[:, 5]
    assert factor_of(rows, weights, 0.05) is None, (
        "a cloud with obstacle costs only does not reveal the unit"
    )


def test_a_compensated_drive_equals_a_drive_without_need_of_compensation():
    from sim_bridge import make
    from training.env.episode import Episode

    unbounded = replace(SPACE, low=np.full(len(SPACE), -np.inf), high=np.full(len(SPACE), np.inf))

    class Rescaled(Episode):
        """Episode that sends parameters converted for a planner with weights per metre, as the
        applr node does.
        """

        def apply(self, theta):
            send(unbounded.settings(theta * multipliers_of(SPACE, 0.05, LARGEST)), self.move_base)
            return theta

    draw = np.random.default_rng(2)
    rows = []
    sets = [SPACE.theta0] + [SPACE.to_theta(draw.uniform(-1.0, 1.0, len(SPACE))) for _ in range(3)]
    for weights, kind in (("per_cell", Episode), ("per_metre", Rescaled), ("per_metre", Episode)):
        parameters = robots.JACKAL.parameters()
        parameters["TrajectoryPlannerROS"]["meter_scoring"] = weights == "per_metre"
        episode = kind(make("kinematic"), MoveBase(parameters), period=2.0)
        episode.reset(worlds.load("generated:3"), 5)
        for theta in sets:
            assert np.array_equal(episode.decide(theta).theta, theta)
        truth = episode.drive.truth
        rows.append(np.column_stack([truth.time, truth.pose, truth.twist]))
    assert np.allclose(rows[0], rows[1], rtol=0.0, atol=1e-9)
    assert not np.array_equal(rows[2], rows[0]), "without compensation the drive must differ"


def test_every_parameter_set_of_the_space_is_within_the_planners_bounds():
    for factor in (0.05, 0.02):
        factors = multipliers_of(SPACE, factor, LARGEST)
        for theta in (SPACE.low, SPACE.high, SPACE.theta0):
            sent = theta * factors
            assert sent[4:7].min() > 0.0
            assert sent[4:7].max() <= 5.0
            assert np.array_equal(np.delete(sent, (4, 5, 6)), np.delete(theta, (4, 5, 6)))
    assert (multipliers_of(SPACE, 1.0, LARGEST) == 1.0).all()


def test_learned_parameter_sets_count_per_cell_and_a_users_set_is_sent_unchanged(tmp_path):
    path = tmp_path / "set.json"
    path.write_text(json.dumps({"meter_scoring": False, "parameters": {"max_vel_x": 0.7}}))
    method = methods.make(str(path))
    assert (method.per_cell, method.theta(None)[0]) == (True, 0.7)
    path.write_text(json.dumps({"max_vel_x": 0.7}))
    assert not methods.make(str(path)).per_cell
    learned = {"applr", "static", "appld"}
    names = learned | {"dwa", "random"}
    assert {name for name in names if methods.make(name).per_cell} == learned
