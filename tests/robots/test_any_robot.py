"""Tests of training and driving a robot that is not included, from its own folder."""

import pytest
import yaml

import sim_bridge
import worlds
from applr_ros1 import robots
from applr_ros1.common.errors import ApplrError
from applr_ros1.planner.costmap.grid import LETHAL
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.policy.actor import load as load_policy
from applr_ros1.policy.observation import layout_of
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.stack.simulated import SimulatedRobot
from applr_ros1.stack.stack import Stack
from training.evaluate import __main__ as evaluate
from training.evaluate.table import read_trials
from training.train import __main__ as train
from training.tune import found_set

CRATE = """\
base:
  {drive: two_wheel, max_speed: 0.8, max_yaw_rate: 2.5,
   max_acceleration: 2.0, max_yaw_acceleration: 8.0,
   wheel_radius: 0.06, wheel_width: 0.02, track: 0.28, axle_height: 0.06, casters: [[-0.14, 0.0]]}
body: {size: [0.36, 0.30, 0.20], centre: [-0.02, 0.0], bottom: 0.03, mass: 8.0}
laser:
  {frame: laser, pose: [0.1, 0.0, 0.0], height: 0.25,
   beams: 241, first_angle: -2.0, last_angle: 2.0,
   range_min: 0.05, range_max: 8.0, rate: 10.0, noise: 0.005}
frames: {base: base_link}
monitor: {deceleration: 1.5, yaw_deceleration: 6.0}
simulation: {grip_limit: 2.0}
world_scale: 0.85
move_base:
  files:
    - {file: costmap.yaml, namespace: local_costmap}
    - {file: costmap.yaml, namespace: global_costmap}
  parameters:
    base_local_planner: dwa_local_planner/DWAPlannerROS
    controller_frequency: 10.0
    planner_frequency: 2.0
    DWAPlannerROS:
      {max_vel_x: 0.5, max_vel_trans: 0.5, max_vel_theta: 1.8, min_vel_theta: 0.3,
       max_vel_y: 0.0, min_vel_y: 0.0, vx_samples: 6, vy_samples: 1, vth_samples: 20,
       acc_lim_x: 2.0, acc_lim_y: 0.0, acc_lim_theta: 5.0, sim_time: 1.2,
       path_distance_bias: 32.0, goal_distance_bias: 24.0}  # these two are tuned
    local_costmap: {rolling_window: true, width: 5, height: 5}
    global_costmap: {rolling_window: false, width: 34, height: 34, origin_x: -17.0, origin_y: -17.0}
parameter_space:
  speed:
    range: [0.3, 0.8]
    sets: [{server: DWAPlannerROS, name: max_vel_x}, {server: DWAPlannerROS, name: max_vel_trans}]
  sim_time: {range: [0.8, 2.5], sets: [{server: DWAPlannerROS}]}
  vth_samples: {range: [8, 40], integer: true, sets: [{server: DWAPlannerROS}]}
  path_distance_bias: {range: [8.0, 64.0], sets: [{server: DWAPlannerROS}]}
  goal_distance_bias: {range: [8.0, 64.0], sets: [{server: DWAPlannerROS}]}
  inflation:
    range: [0.1, 0.6]
    sets:
      - {server: local_costmap/inflater_layer, name: inflation_radius}
      - {server: global_costmap/inflater_layer, name: inflation_radius}
  patience: {range: [2.0, 20.0], sets: [{server: "", name: planner_patience}]}
"""
COSTMAP = """\
global_frame: odom
robot_base_frame: base_link
footprint: [[-0.20, -0.15], [-0.20, 0.15], [0.16, 0.15], [0.16, -0.15]]
footprint_padding: 0.05
update_frequency: 10.0
resolution: 0.05
plugins:
  - {name: obstacles_layer, type: "costmap_2d::ObstacleLayer"}
  - {name: inflater_layer, type: "costmap_2d::InflationLayer"}
obstacles_layer:
  observation_sources: scan
  scan: {data_type: LaserScan, topic: scan, sensor_frame: laser, marking: true, clearing: true}
inflater_layer: {inflation_radius: 0.3, cost_scaling_factor: 8.0}   # metres
"""
# A sparse world and the fast simulator, in which a drive takes seconds
ONE_WORLD = ["--simulator", "kinematic", "--worlds", "generated:3"]


@pytest.fixture
def crate(tmp_path):
    """Write the folder of the robot, and return its path."""
    folder = tmp_path / "crate"
    folder.mkdir()
    (folder / "robot.yaml").write_text(CRATE)
    (folder / "costmap.yaml").write_text(COSTMAP)
    # A robot takes no more than this to write by hand.
    assert len((CRATE + COSTMAP).splitlines()) <= 60 + 15
    return folder


def trials_of(out):
    """Return the rows of an evaluation's table by method."""
    trials = read_trials(out / "trials.csv").to_dict("records")
    return {trial["method"]: trial for trial in trials}


def test_space_and_layout_follow_the_description(crate):
    robot = robots.load(str(crate))
    space = space_of(robot)
    layout = layout_of(robot)
    assert space.as_dict(space.theta0) == {
        "speed": 0.5,
        "sim_time": 1.2,
        "vth_samples": 20,
        "path_distance_bias": 32.0,
        "goal_distance_bias": 24.0,
        "inflation": 0.3,
        "patience": 5.0,
    }
    assert layout.beams == 241
    assert layout.angle_min == -2.0
    # The Jackal's cap of 2 m at 0.85 of its size
    assert layout.range_cap == pytest.approx(1.7)

    # Highest values of all parameters reach their servers.
    planner = MoveBase(robot.parameters())
    in_force = planner.put_in_force(space.settings(space.high))
    assert space.read_back(in_force).tolist() == space.high.tolist()
    assert in_force["DWAPlannerROS"]["max_vel_trans"] == 0.8
    assert in_force[""]["planner_patience"] == 20.0


def test_obstacles_count_at_the_lasers_height_in_simulation_too(crate):
    """An observation source that drops points near the ground must still mark the laser's points in
    simulation.
    """
    costmap = COSTMAP.replace("topic: scan,", "topic: scan, min_obstacle_height: 0.2,")
    (crate / "costmap.yaml").write_text(costmap)
    robot = robots.load(str(crate))
    planner = MoveBase(robot.parameters())
    stack = Stack(robot, planner, monitor=False)
    simulated = SimulatedRobot(sim_bridge.make("kinematic", robot=robot), stack)
    simulated.reset(worlds.scaled(worlds.load("generated:3"), robot.world_scale), seed=0)
    simulated.cycle()
    assert (planner.local_costmap.cells == LETHAL).any()


@pytest.mark.slow
def test_a_robot_is_trained_and_driven_from_its_folder(crate, tmp_path, capsys):
    # Given: a tuned set, and a policy that was trained a little
    run_folder = tmp_path / "run"
    results_folder = tmp_path / "out"
    tuned_values = {"speed": 0.7, "sim_time": 1.0, "obstacle_range": 2.0}
    tuned_file = crate / "tuned.yaml"
    robot = robots.load(str(crate))
    found_set.write_set(robot, tuned_values, crate / "static.json", tuned_file)
    # 12 decisions, the last of which is followed by the only evaluation
    training = ["--total-timesteps", "12", "--net-arch", "16", "16", "--batch-size", "8"]
    training += ["--eval-worlds", "generated:3", "--eval-freq", "12", "--out", str(run_folder)]
    training += ["--init-from", "static"]
    assert train.main(["--robot", str(crate), *ONE_WORLD, *training]) == 0
    policy_file = run_folder / "best.safetensors"

    # Then: the robot drives with the defaults, with the set and with the policy
    driving = ["--robot", str(crate), *ONE_WORLD, "--out", str(results_folder)]
    methods = ["--methods", f"dwa,static,{policy_file}"]
    one_trial = ["--trials", "1", "--workers", "0", "--monitor"]
    assert evaluate.main([*driving, *methods, *one_trial]) == 0
    trials = trials_of(results_folder)
    assert trials["dwa"]["success"]
    # The course of 5.925 m at 0.85 of its size
    assert trials["dwa"]["path_length_m"] == pytest.approx(0.85 * 5.925, rel=0.35)
    assert trials["static"]["time_s"] != trials["dwa"]["time_s"]

    # The policy is for this robot alone.
    robot = robots.load(str(crate))
    policy = load_policy(policy_file, robot)
    assert policy.layout == layout_of(robot)
    assert policy.metadata["robot"] == "crate"
    # It learnt with the obstacle range of the set from which it started.
    assert policy.obstacle_range == 2.0
    with pytest.raises(ApplrError, match="for the robot crate: this robot is jackal"):
        load_policy(policy_file)

    # A method that the robot has no file for is refused.
    capsys.readouterr()
    assert evaluate.main([*driving, "--methods", "appld"]) == 1
    assert capsys.readouterr().err.count("\n") == 1

    # tuned.yaml has the set under move_base's names.
    planner_values = yaml.safe_load(tuned_file.read_text())["DWAPlannerROS"]
    assert planner_values["max_vel_x"] == 0.7
    assert planner_values["max_vel_trans"] == 0.7
    assert planner_values["sim_time"] == 1.0
