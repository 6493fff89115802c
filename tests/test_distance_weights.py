"""What a planner's distance weights count: found from its cost_cloud, and made up for without changing the drive."""

import json

import numpy as np
import pytest
from toy_robot import ToyRobot, quick, ring, run

import worlds
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.policy import methods
from applr_ros1.policy.distance_weights import Compensation, factor_of, fit, stated_weights, weights_of_set
from applr_ros1.policy.parameter_space import SPACE, SpaceError


def cloud(weights, seed):
    """(rows of cost_cloud, theta) of a robot that has just set out among posts, with parameters drawn from a seed."""
    draw = np.random.default_rng(seed)
    made = MoveBase(quick(), weights, seed=seed)
    robot = ToyRobot(circles=ring(0.0, 0.0, draw.uniform(1.0, 2.0), posts=int(draw.integers(0, 7))))
    theta = SPACE.to_theta(draw.uniform(-1.0, 1.0, len(SPACE)))
    for server, values in SPACE.requests(theta).items():
        made.reconfigure(server, values)
    made.set_goal((*draw.uniform(-4.0, 4.0, 2), 0.0), 0.0)
    run(made, robot, 0.15)
    return made, made.local_planner.cost_cloud(made.local_costmap), theta


def test_weights_are_found_in_20_of_20_starts():
    words = []
    for seed in range(20):
        made, rows, theta = cloud("drawn", seed)
        word, path, goal, occ = made.variant.weights, theta[5], theta[6], theta[4]
        effective = fit(np.vstack([rows, np.zeros((500, 7), np.float32)]))  # C++ fills its clouds up with zeros
        factor = factor_of(effective, path, goal)
        assert factor == {"per_cell": 1.0, "per_metre": 0.05}[word]
        assert effective[:2] == pytest.approx((path * factor, goal * factor), rel=1e-4)
        assert np.isnan(effective.occ) or effective.occ == pytest.approx(occ, rel=1e-3)
        assert effective.spacing == pytest.approx(0.05, rel=1e-4)
        assert factor_of(effective, 1.1 * path, goal) is None  # a cloud from before a change
        words.append(word)
    assert set(words) == {"per_cell", "per_metre"}
    assert fit(rows[:5]) is None
    rows[:, 4] = 2.0 * rows[:, 3]
    assert fit(rows) is None, "one distance says nothing of two weights"


@pytest.mark.parametrize(("meant", "planner"), [("per_metre", "per_cell"), ("per_cell", "per_metre")])
def test_a_compensated_drive_equals_one_that_needed_none(meant, planner):
    from sim_bridge import make
    from training.mdp.episode import Episode

    draw, rows = np.random.default_rng(2), []
    sets = [SPACE.theta0] + [SPACE.to_theta(draw.uniform(-1.0, 1.0, len(SPACE))) for _ in range(3)]
    for weights, told in ((meant, meant), (planner, meant), (planner, None)):
        episode = Episode(make("kinematic"), MoveBase(weights=weights), record=True)
        episode.meant = told
        episode.reset(worlds.load("generated:3"), 5)
        for theta in sets:
            outcome = episode.decide(theta)
            assert np.array_equal(outcome.theta, theta), "as the set is meant, not as it is sent"
        trace = episode.trace
        rows.append([trace.time, trace.pose, trace.twist, trace.command])
    assert rows[1] == rows[0]
    assert rows[2] != rows[0], "without compensation it drives otherwise"


def test_every_set_of_the_space_can_be_sent_within_the_planners_bounds():
    for meant, factor in (("per_metre", 1.0), ("per_cell", 0.05), ("per_cell", 0.02)):
        made = Compensation(SPACE, meant, factor, 0.05)
        for theta in (SPACE.low, SPACE.high, SPACE.theta0):
            sent = made.outgoing(theta)
            assert sent[4:7].min() > 0.0
            assert sent[4:7].max() <= 5.0
            assert np.array_equal(np.delete(sent, (4, 5, 6)), np.delete(theta, (4, 5, 6)))
            assert made.incoming(sent) == pytest.approx(theta, rel=1e-12)
    for meant, factor in (("per_cell", 1.0), ("per_metre", 0.05), ("drawn", 0.05), (None, 1.0)):
        assert not Compensation(SPACE, meant, factor, 0.05).needed


def test_what_a_file_states_and_what_it_means_when_it_states_nothing(tmp_path):
    assert stated_weights({}) == stated_weights({"training": {"options": {"steps": 3}}}) == "per_metre"
    assert stated_weights({"training": {"options": {"weights": "drawn"}}}) == "drawn"
    assert stated_weights({"weights": "per_cell", "training": {"options": {"weights": "drawn"}}}) == "per_cell"
    path = tmp_path / "set.json"
    path.write_text(json.dumps({"weights": "per_cell", "parameters": {"max_vel_x": 0.7}}))
    made = methods.make(str(path))
    assert (made.weights, made.theta(None)[0]) == ("per_cell", 0.7)
    path.write_text(json.dumps({"max_vel_x": 0.7}))
    assert weights_of_set(path) is None
    path.write_text(json.dumps({"weights": "heavy", "parameters": {}}))
    with pytest.raises(SpaceError, match="weights is 'heavy': give per_metre, per_cell or drawn"):
        methods.make(str(path))
    kinds = {name: methods.make(name).weights for name in ("dwa", "random", "appld:published", "appld")}
    assert kinds == {"dwa": None, "random": None, "appld:published": None, "appld": "per_cell"}
    assert methods.make("frozen:vx_samples:applr").weights == methods.make("applr").weights
