"""Tests of the unit of a planner's distance biases: detected from cost_cloud, and compensated."""

import numpy as np
import pytest

import worlds
from applr_ros1 import robots
from applr_ros1.nodes.applr.distance_weights import multipliers_of
from applr_ros1.nodes.applr.meter_scoring import factor_of
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.policy.parameter_space import SPACE
from tests.support.robots import ToyRobot, quick, ring, run

# Upper bounds of TrajectoryPlannerROS for its biases.
LARGEST = np.full(len(SPACE), 5.0)
# Columns of the three weights in a parameter set: of the path, of the goal, of obstacles
WEIGHTS = [5, 6, 4]
CELL_M = 0.05  # edge of a cell of the local costmap [m]
# Factor by which a planner's weights differ from weights per cell
FACTORS = {"per_cell": 1.0, "per_metre": CELL_M}
PADDING = np.zeros((500, 7), np.float32)  # C++ pads its clouds with zeros.


def tree(weights):
    """Return parameters of move_base with weights "per_cell" or "per_metre"."""
    tree = quick()
    planner = dict(tree["TrajectoryPlannerROS"], meter_scoring=weights == "per_metre")
    tree["TrajectoryPlannerROS"] = planner
    return tree


def cloud(weights, seed):
    """Return the cost_cloud of a robot that has just set out among posts, and its parameters."""
    rng = np.random.default_rng(seed)
    move_base = MoveBase(tree(weights))
    radius = rng.uniform(1.0, 2.0)
    posts = int(rng.integers(0, 7))
    robot = ToyRobot(circles=ring(0.0, 0.0, radius, posts=posts))
    theta = SPACE.to_theta(rng.uniform(-1.0, 1.0, len(SPACE)))
    move_base.put_in_force(SPACE.settings(theta))
    goal_x, goal_y = rng.uniform(-4.0, 4.0, 2)
    move_base.set_goal((goal_x, goal_y, 0.0), 0.0)
    run(move_base, robot, 0.15)
    return move_base.local_planner.cost_cloud(move_base.local_costmap), theta


@pytest.mark.parametrize("unit", FACTORS)
@pytest.mark.parametrize("seed", range(10))
def test_the_unit_of_the_weights_is_detected_in_every_start(unit, seed):
    rows, theta = cloud(unit, seed)
    weights = theta[WEIGHTS]
    cells = np.vstack([rows, PADDING])

    assert factor_of(cells, weights, CELL_M) == FACTORS[unit]
    for changed in ((1.1, 1.0, 1.0), (1.0, 1.1, 1.0)):
        factor = factor_of(cells, weights * changed, CELL_M)
        assert factor is None, "the cloud is older than a change of the weights"


def test_a_cloud_of_few_cells_or_of_obstacle_costs_only_does_not_reveal_the_unit():
    rows, theta = cloud("per_metre", seed=19)
    weights = theta[WEIGHTS]
    few_cells = np.vstack([rows[:5], PADDING])
    obstacle_costs = rows.copy()
    # Columns 5 and 6 are the cost of the cell and the total cost.
    obstacle_costs[:, 6] = weights[2] * obstacle_costs[:, 5]

    assert factor_of(few_cells, weights, CELL_M) is None
    assert factor_of(obstacle_costs, weights, CELL_M) is None


def test_a_compensated_drive_equals_a_drive_without_need_of_compensation():
    from applr_ros1.drives.simulate import CourseDrive
    from applr_ros1.stack.simulated import SimulatedRobot
    from applr_ros1.stack.stack import Stack
    from sim_bridge import make

    class Rescaled(CourseDrive):
        """Drive that converts parameters for weights per metre, as the applr node does."""

        def apply(self, theta):
            sent = theta * multipliers_of(SPACE, CELL_M, LARGEST)
            self.simulated.stack.move_base.put_in_force(SPACE.settings(sent))
            return theta

    rng = np.random.default_rng(2)
    sets = [SPACE.theta0]
    for _ in range(3):
        sets.append(SPACE.to_theta(rng.uniform(-1.0, 1.0, len(SPACE))))

    def driven(kind, weights):
        """Return the true motion of a drive with all parameter sets: time, pose and twist."""
        parameters = robots.JACKAL.parameters()
        parameters["TrajectoryPlannerROS"]["meter_scoring"] = weights == "per_metre"
        stack = Stack(robots.JACKAL, MoveBase(parameters), monitor=False)
        simulated = SimulatedRobot(make("kinematic"), stack)
        world = worlds.load("generated:3")
        course_drive = kind(simulated, world, seed=5, period=2.0, theta=SPACE.theta0)
        for theta in sets:
            course_drive.decide(theta)
            assert np.array_equal(course_drive.theta, theta)
            course_drive.advance()
        truth = course_drive.drive.truth
        return np.column_stack([truth.time, truth.pose, truth.twist])

    expected = driven(CourseDrive, "per_cell")
    assert np.allclose(driven(Rescaled, "per_metre"), expected, rtol=0.0, atol=1e-9)
    uncompensated = driven(CourseDrive, "per_metre")
    assert not np.array_equal(uncompensated, expected), "without compensation the drive must differ"


def test_every_parameter_set_of_the_space_is_within_the_planners_bounds():
    for factor in (0.05, 0.02):
        factors = multipliers_of(SPACE, factor, LARGEST)
        for theta in (SPACE.low, SPACE.high, SPACE.theta0):
            sent = theta * factors
            assert sent[WEIGHTS].min() > 0.0
            assert sent[WEIGHTS].max() <= 5.0
            assert np.array_equal(np.delete(sent, WEIGHTS), np.delete(theta, WEIGHTS))
    unchanged = multipliers_of(SPACE, 1.0, LARGEST)
    assert (unchanged == 1.0).all()
