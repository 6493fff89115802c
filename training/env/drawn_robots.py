"""Robots that are drawn at random, so that a policy in the dimensionless form learns to drive any of them.

They are described as a robot.yaml describes one: a base of two driven wheels or of four that skid, a laser, and the
parameters that a maker delivers for TrajectoryPlannerROS or DWAPlannerROS, or others near them.
"""

from __future__ import annotations

import math
from typing import Any, Dict

import numpy as np

from applr_ros1.policy.dimensionless import JACKAL_WIDTH
from applr_ros1.robots import JACKAL, NAMES, Robot, load
from applr_ros1.robots.default_space import DWA, default_space
from applr_ros1.robots.description import (
    Base,
    Body,
    Frames,
    Laser,
    LoadedFile,
    Monitoring,
    MoveBaseSetup,
    OdometryErrors,
    Simulation,
    Topics,
)

NAME = "drawn"  # as a robot's name in training: each episode draws one
JACKALS, OTHERS = 0.3, 0.3  # shares of episodes that the Jackal and the other included robots drive


def draw(rng: np.random.Generator) -> Robot:
    """The Jackal, another included robot, or in two of five draws a robot that has never been before."""
    which = rng.random()
    if which < JACKALS:
        return JACKAL
    if which < JACKALS + OTHERS:
        return load(str(rng.choice([name for name in NAMES if name != JACKAL.name])))
    return draw_another(rng)


def draw_another(rng: np.random.Generator) -> Robot:
    """A robot .18 to .95 m wide (with padding) that drives at most .2 to 2 m/s."""
    padded = _log_uniform(rng, 0.18, 0.95)
    padding = padded * rng.uniform(0.02, 0.2)
    width = padded - 2.0 * padding
    length = width * rng.uniform(1.0, 1.6)
    speed = _log_uniform(rng, max(0.15, 0.5 * padded), min(2.0, 4.5 * padded))
    turn = rng.uniform(1.0, 4.0)
    skid = rng.random() < 0.5
    braking = speed * rng.uniform(1.5, 12.0)
    wheel = 0.15 * width
    friction = rng.uniform(0.4, 1.0)
    base = Base(
        drive="skid_steer" if skid else "two_wheel",
        max_speed=speed,
        max_yaw_rate=turn,
        max_acceleration=braking,
        max_yaw_acceleration=turn * rng.uniform(2.0, 8.0),
        wheel_radius=wheel,
        wheel_width=0.08 * width,
        track=0.9 * width,
        axle_height=wheel,
        wheelbase=0.6 * length if skid else 0.0,
        wheel_friction=friction,
        casters=() if skid else ((-0.4 * length, 0.0),),
    )
    x = 0.0 if skid else -0.15 * length
    body = Body(
        size=(length, width, 0.5 * width),
        mass=90.0 * width**2,
        centre=(x, 0.0),
        com=(x + rng.uniform(-0.03, 0.03) * length if skid else -0.1 * length, 0.0, 0.2 * width),
    )
    half = math.pi if rng.random() < 0.4 else rng.uniform(0.5, 0.95) * math.pi
    laser = Laser(
        frame="laser",
        pose=(rng.uniform(-0.2, 0.35) * length, 0.0, 0.0),
        height=0.5 * width,
        beams=int(rng.choice([240, 360, 541, 720])),
        first_angle=-half,
        last_angle=half,
        range_min=0.05,
        range_max=float(rng.choice([3.5, 8.0, 30.0])),
        rate=float(rng.choice([5.0, 10.0, 20.0, 50.0])),
        noise=rng.uniform(0.001, 0.01),
    )
    tree = _parameters(rng, base, body, padding, padded)
    return Robot(
        name=NAME,
        folder="",
        base=base,
        body=body,
        laser=laser,
        topics=Topics(),
        frames=Frames(base="base_link"),
        odometry=OdometryErrors(),
        monitor=Monitoring(
            margin=0.05 * width,
            reaction_time=0.15,
            deceleration=0.6 * min(braking, 7.0 * friction),
            yaw_deceleration=0.6 * base.max_yaw_acceleration,
        ),
        simulation=_simulation(rng, skid, friction, width, speed),
        world_scale=padded / JACKAL_WIDTH * rng.uniform(0.95, 1.2),
        space=default_space(base, body, tree),
        move_base=MoveBaseSetup((LoadedFile("robot.yaml", "", tree),)),
    )


def _simulation(rng: np.random.Generator, skid: bool, friction: float, width: float, speed: float) -> Simulation:
    """Half of the robots that skid stand on Gazebo's ground, where they turn faster than they are told."""
    gazebo = skid and rng.random() < 0.5
    return Simulation(
        grip_limit=6.0 * friction,
        motor_torque=60.0 * width**2,
        wheel_shake=0.005 * speed,
        ground="gazebo" if gazebo else "plain",
        track_multiplier=rng.uniform(1.2, 1.6) if gazebo else None,
        command_delay=rng.uniform(0.0, 0.05),
    )


def _parameters(rng: np.random.Generator, base: Base, body: Body, padding: float, padded: float) -> Dict[str, Any]:
    """A parameter tree of move_base, as a maker delivers it or up to some way off."""
    dwa, fast = rng.random() < 0.6, rng.uniform(0.3, 1.0)
    speed, turn = fast * base.max_speed, rng.uniform(0.4, 1.0) * base.max_yaw_rate
    half, side = 0.5 * body.size[0], 0.5 * body.size[1]
    x = body.centre[0]
    outline = [[x - half, -side], [x - half, side], [x + half, side], [x + half, -side]]
    rate = float(rng.choice([5.0, 10.0, 20.0]))

    def near(value: float, factor: float = 2.0) -> float:
        return value * factor ** rng.uniform(-1.0, 1.0)

    planner: Dict[str, Any] = {
        "acc_lim_x": base.max_acceleration * rng.uniform(0.6, 1.2),
        "acc_lim_theta": base.max_yaw_acceleration * rng.uniform(0.6, 1.2),
        "max_vel_x": speed,
        "max_vel_theta": turn,
        "xy_goal_tolerance": 0.4 * padded,
        "yaw_goal_tolerance": 0.2,
        "sim_time": rng.uniform(1.2, 2.2),
        "vx_samples": int(rng.integers(4, 21)),
    }
    if dwa:
        planner.update(
            max_vel_trans=speed,
            min_vel_trans=rng.uniform(0.0, 0.5) * speed,
            min_vel_x=float(rng.choice([0.0, -0.2, -1.0])) * speed,
            min_vel_theta=rng.uniform(0.1, 0.5) * turn,
            max_vel_y=0.0,
            min_vel_y=0.0,
            acc_lim_y=0.0,
            vth_samples=int(rng.integers(16, 41)),
            path_distance_bias=near(32.0),
            goal_distance_bias=near(22.0),
            occdist_scale=near(0.02, 4.0),
            forward_point_distance=float(rng.choice([0.325, rng.uniform(0.1, 0.8) * padded])),
            scaling_speed=0.8 * speed,
        )
    else:
        planner.update(
            min_vel_x=0.1 * speed,
            min_vel_theta=-turn,
            min_in_place_vel_theta=0.2 * turn,
            escape_vel=-0.2 * base.max_speed,
            holonomic_robot=False,
            vtheta_samples=20,
            path_distance_bias=near(0.7),
            goal_distance_bias=near(0.9),
            occdist_scale=near(0.05, 4.0),
            heading_lookahead=0.6 * padded,
            sim_granularity=0.025,
            dwa=bool(rng.random() < 0.7),
        )
    reach = float(rng.uniform(2.5, 5.0))
    layers = [
        {"name": "obstacle_layer", "type": "costmap_2d::ObstacleLayer"},
        {"name": "inflation_layer", "type": "costmap_2d::InflationLayer"},
    ]
    scan = {"data_type": "LaserScan", "topic": "scan", "sensor_frame": "laser", "marking": True, "clearing": True}
    common = {
        "footprint": outline,
        "footprint_padding": padding,
        "robot_base_frame": "base_link",
        "global_frame": "odom",
        "update_frequency": min(rate, 10.0),
        "transform_tolerance": 0.5,
        "resolution": 0.05,
        "plugins": layers,
        "obstacle_layer": {
            "observation_sources": "scan",
            "obstacle_range": reach,
            "raytrace_range": reach + 0.5,
            "scan": scan,
        },
        "inflation_layer": {"inflation_radius": near(0.9 * padded), "cost_scaling_factor": near(6.0)},
    }
    local = int(np.clip(14.0 * padded, 3.0, 8.0))
    return {
        "base_local_planner": "dwa_local_planner/DWAPlannerROS" if dwa else "base_local_planner/TrajectoryPlannerROS",
        DWA if dwa else "TrajectoryPlannerROS": planner,
        "controller_frequency": rate,
        "planner_frequency": float(rng.choice([1.0, 5.0, 10.0])),
        "controller_patience": 15.0,
        "local_costmap": {**common, "rolling_window": True, "width": local, "height": local},
        "global_costmap": {**common, "width": 40, "height": 40, "origin_x": -20.0, "origin_y": -20.0},
    }


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return low * (high / low) ** rng.random()
