"""Bullet scene of PybulletSimulator: import of pybullet, ground, obstacles and robot.

This module works around five traits of pybullet. The import and every connection print a line.
Meshes are never freed, so one mesh per world would leak memory. Single bodies are several times
slower than compounds. A compound keeps only its first 16 shapes. A body without a visual shape gets
a mesh for each round part, which takes thirty times as long as the body.
"""

from __future__ import annotations

import ctypes
import math
import os
import sys
from typing import Any, List, NamedTuple, Sequence, Tuple

import numpy as np

from applr_ros1.common.angles import Pose, quaternion_of, transform_point
from applr_ros1.common.arrays import Array
from applr_ros1.robots import Robot, geometry
from worlds import World

from .mechanics import GRAVITY, mechanics

CASTER_MASS_KG = 0.001  # mass of a caster, subtracted from the body [kg]
CASTER_INERTIA = (1e-8, 1e-8, 1e-8)  # moments of inertia of a caster [kg m^2]
OBSTACLE_TOP_M = 1.0  # height of all obstacles, above every laser [m]
_COMPOUND_SHAPES = 16  # largest number of shapes that createCollisionShapeArray keeps in one body
_STDOUT, _STDERR = 1, 2  # file descriptors
_UPRIGHT = (0, 0, 0, 1)  # quaternion of no rotation
# Functions that are called in every step
_OFTEN_CALLED = (
    "applyExternalForce",
    "applyExternalTorque",
    "getBasePositionAndOrientation",
    "getBaseVelocity",
    "getContactPoints",
    "resetBasePositionAndOrientation",
    "setJointMotorControlArray",
    "stepSimulation",
)
GROUND = 0  # Bullet's id of the ground, the first body
_BASE = -1  # Bullet's index of a body's base, which is not a link


class Obstacle(NamedTuple):
    """Upright cylinder or box."""

    x: float  # [m]
    y: float
    yaw: float  # [rad]
    radius: float  # radius of a cylinder, 0 of a box [m]
    half_sizes: Tuple[float, float, float]  # half length, width and height of a box [m]


def connect() -> Any:
    """Return a new client of Bullet, without a window and without the lines that it prints."""
    sys.stdout.flush()
    sys.stderr.flush()
    # Bullet's C code writes to the file descriptors, which Python's redirection does not reach.
    null_device = os.open(os.devnull, os.O_WRONLY)
    saved_descriptors = {descriptor: os.dup(descriptor) for descriptor in (_STDOUT, _STDERR)}
    try:
        for descriptor in saved_descriptors:
            os.dup2(null_device, descriptor)
        from pybullet_utils.bullet_client import BulletClient

        client = BulletClient(sys.modules["pybullet"].DIRECT)
        # The client makes a new function object at every access: keep those that are used often.
        for name in _OFTEN_CALLED:
            setattr(client, name, getattr(client, name))
        return client
    finally:
        ctypes.CDLL(None).fflush(None)  # The lines may still be in C's buffer of stdout.
        for descriptor, saved_descriptor in saved_descriptors.items():
            os.dup2(saved_descriptor, descriptor)
            os.close(saved_descriptor)
        os.close(null_device)


def empty(client: Any, step: float) -> None:
    """Remove everything from a client's scene except the ground. `step` is the physics step [s]."""
    client.resetSimulation()
    client.setGravity(0, 0, -GRAVITY)
    # Pairs in a fixed order, because the solver's result depends on the order.
    client.setPhysicsEngineParameter(
        fixedTimeStep=step,
        numSolverIterations=30,
        deterministicOverlappingPairs=1,
        enableFileCaching=0,
    )
    ground_shape = client.createCollisionShape(client.GEOM_PLANE)
    # wheels.py computes the friction.
    _fixed_body(client, ground_shape, _look(client), friction=0.0)


def build_obstacles(client: Any, world: World) -> Array:
    """Create the static obstacles of a world, several in one body.

    Returns:
        A circle (n, 3) around each obstacle: x, y, radius [m].
    """
    look = _look(client)
    circles = []
    for group in _groups(world):
        _compound(client, group, look)
        for obstacle in group:
            radius = obstacle.radius or math.hypot(*obstacle.half_sizes[:2])
            circles.append((obstacle.x, obstacle.y, radius))
    return np.array(circles, dtype=float).reshape(-1, 3)


def build_movers(client: Any, circles: Array) -> List[int]:
    """Create moving cylinders (k, 3) x, y, radius [m], and return their ids.

    The simulator moves them.
    """
    look = _look(client)
    bodies = []
    for x, y, radius in circles.tolist():
        shape = client.createCollisionShape(
            client.GEOM_CYLINDER, radius=radius, height=OBSTACLE_TOP_M
        )
        body = _fixed_body(client, shape, look)
        put_mover(client, body, x, y)
        bodies.append(body)
    return bodies


def _look(client: Any) -> int:
    """Return a visual shape: Bullet makes a mesh for each body, or link, without one."""
    look: int = client.createVisualShape(client.GEOM_BOX, halfExtents=(0.1, 0.1, 0.1))
    return look


def _fixed_body(client: Any, shape: int, look: int, friction: float = 1.0) -> int:
    """Create a body that no force moves, and return its id."""
    # Without maximal coordinates, a physics step takes longer with each body.
    body: int = client.createMultiBody(0, shape, look, useMaximalCoordinates=1)
    client.changeDynamics(body, _BASE, lateralFriction=friction)
    return body


def put_mover(client: Any, body: int, x: float, y: float) -> None:
    """Move a moving cylinder to (x, y) [m]."""
    client.resetBasePositionAndOrientation(body, (x, y, OBSTACLE_TOP_M / 2), _UPRIGHT)


def build_robot(client: Any, robot: Robot, pose: Pose) -> int:
    """Create the robot at pose (x, y, yaw), and return its id.

    The driven wheels are joints in the order of geometry.wheel_places, and casters are fixed
    spheres that slide on the ground. The origin of the body's frame is its centre of mass.
    """
    base = robot.base
    body = robot.body
    robot_mechanics = mechanics(robot)
    com_x, com_y, com_z = robot_mechanics.body_com
    length, width, height = body.size
    body_shape = client.createCollisionShape(
        client.GEOM_CYLINDER if body.round else client.GEOM_BOX,
        halfExtents=[length / 2, width / 2, height / 2],
        radius=(length + width) / 4,
        height=height,
        collisionFramePosition=[
            body.centre[0] - com_x,
            body.centre[1] - com_y,
            body.bottom + height / 2 - com_z,
        ],
    )

    # The wheels, then the casters: a shape and a place relative to the centre of mass for each link
    wheel_shape = client.createCollisionShape(
        client.GEOM_CYLINDER,
        radius=base.wheel_radius,
        height=base.wheel_width,
        collisionFrameOrientation=client.getQuaternionFromEuler([math.pi / 2, 0, 0]),
    )
    shapes = []
    positions = []
    for x, y in geometry.wheel_places(base):
        shapes.append(wheel_shape)
        positions.append((x - com_x, y - com_y, base.axle_height - com_z))
    if base.casters:
        radius = geometry.caster_radius(robot)
        caster_shape = client.createCollisionShape(client.GEOM_SPHERE, radius=radius)
        for x, y in base.casters:
            shapes.append(caster_shape)
            positions.append((x - com_x, y - com_y, radius - robot_mechanics.base_height - com_z))

    wheels = base.wheels
    casters = len(base.casters)
    links = wheels + casters
    look = _look(client)
    position, attitude = _standing(robot, pose)
    multi_body: int = client.createMultiBody(
        body.mass - casters * CASTER_MASS_KG,
        body_shape,
        look,
        position,
        attitude,
        linkMasses=[base.wheel_mass] * wheels + [CASTER_MASS_KG] * casters,
        linkCollisionShapeIndices=shapes,
        linkVisualShapeIndices=[look] * links,
        linkPositions=positions,
        linkOrientations=[_UPRIGHT] * links,
        linkInertialFramePositions=[(0, 0, 0)] * links,
        linkInertialFrameOrientations=[_UPRIGHT] * links,
        linkParentIndices=[0] * links,
        linkJointTypes=[client.JOINT_REVOLUTE] * wheels + [client.JOINT_FIXED] * casters,
        linkJointAxis=[(0, 1, 0)] * links,
    )

    def set_dynamics(link: int, inertia: Sequence[float], friction: float, **options: Any) -> None:
        client.changeDynamics(
            multi_body,
            link,
            localInertiaDiagonal=inertia,
            lateralFriction=friction,
            linearDamping=0,
            angularDamping=0,
            **options,
        )

    # Bullet's damping is switched off: it would brake a rolling robot like thick air.
    set_dynamics(_BASE, robot_mechanics.body_inertia, body.friction)
    simulation = robot.simulation
    tyre = {
        "contactStiffness": simulation.ground_stiffness,
        "contactDamping": simulation.ground_damping,
        "jointDamping": 0,
    }
    for link in range(wheels):
        set_dynamics(link, robot_mechanics.wheel_inertia, base.wheel_friction, **tyre)
    for link in range(wheels, links):
        set_dynamics(link, CASTER_INERTIA, base.caster_friction, **tyre)
    return multi_body


def put_robot(client: Any, body: int, robot: Robot, pose: Pose) -> None:
    """Place the robot of build_robot() at rest at pose (x, y, yaw)."""
    position, attitude = _standing(robot, pose)
    client.resetBasePositionAndOrientation(body, position, attitude)
    client.resetBaseVelocity(body, (0, 0, 0), (0, 0, 0))
    for wheel in range(robot.base.wheels):
        client.resetJointState(body, wheel, 0.0, 0.0)


def _standing(
    robot: Robot, pose: Pose
) -> Tuple[Tuple[float, float, float], Tuple[float, float, float, float]]:
    """Return position [m] and attitude of the body's centre of mass for a robot at rest at `pose`.

    The tyres are compressed as far as the weight needs, so that the robot does not drop at a start.
    """
    robot_mechanics = mechanics(robot)
    com_x, com_y, com_z = robot_mechanics.body_com
    load = robot_mechanics.mass * GRAVITY / len(robot_mechanics.supports)
    compression = load / robot.simulation.ground_stiffness
    x, y = transform_point(pose, com_x, com_y)
    return (x, y, robot_mechanics.base_height + com_z - compression), quaternion_of(pose[2])


def _groups(world: World) -> List[List[Obstacle]]:
    """Return the static obstacles in groups of neighbours, one group per body of Bullet."""
    obstacles = []
    for x, y, radius in np.asarray(world.cylinders, dtype=float).reshape(-1, 3).tolist():
        obstacles.append(Obstacle(x, y, 0.0, radius, (0.0, 0.0, 0.0)))
    for x, y, yaw, size_x, size_y in np.asarray(world.boxes, dtype=float).reshape(-1, 5).tolist():
        half_sizes = (size_x / 2, size_y / 2, OBSTACLE_TOP_M / 2)
        obstacles.append(Obstacle(x, y, yaw, 0.0, half_sizes))
    # Rows of 1 m, so that Bullet can exclude most bodies by their bounding boxes.
    obstacles.sort(key=lambda obstacle: (round(obstacle.y), obstacle.x))
    starts = range(0, len(obstacles), _COMPOUND_SHAPES)
    return [obstacles[start : start + _COMPOUND_SHAPES] for start in starts]


def _compound(client: Any, obstacles: List[Obstacle], look: int) -> None:
    """Create one static body of obstacles with the visual shape `look`."""
    shape_types = []
    positions = []
    for obstacle in obstacles:
        shape_types.append(client.GEOM_CYLINDER if obstacle.radius else client.GEOM_BOX)
        positions.append((obstacle.x, obstacle.y, OBSTACLE_TOP_M / 2))
    shape = client.createCollisionShapeArray(
        shapeTypes=shape_types,
        radii=[obstacle.radius for obstacle in obstacles],
        lengths=[OBSTACLE_TOP_M] * len(obstacles),
        halfExtents=[obstacle.half_sizes for obstacle in obstacles],
        collisionFramePositions=positions,
        collisionFrameOrientations=[quaternion_of(obstacle.yaw) for obstacle in obstacles],
    )
    _fixed_body(client, shape, look)
