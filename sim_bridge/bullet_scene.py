"""Bullet scene of PybulletSimulator: import of pybullet, ground, obstacles and robot.

This module works around five traits of pybullet. The import and every connection print a line. Meshes are never freed,
so one mesh per world would leak memory. Single bodies are several times slower than compounds. A compound keeps
only its first 16 shapes. A body without a visual shape gets a mesh for each round part, which takes thirty times as
long as the body.
"""

from __future__ import annotations

import ctypes
import math
import os
import sys
from typing import Any, List, Sequence, Tuple

import numpy as np

from applr_ros1.common.angles import Pose, quaternion_of, transform_point
from applr_ros1.common.arrays import Array
from applr_ros1.robots import Robot, geometry
from worlds import Mover, World

from .mechanics import GRAVITY, mechanics

CASTER_MASS_KG = 0.001  # mass of a caster, subtracted from the body [kg]
OBSTACLE_TOP_M = 1.0  # height of all obstacles, above every laser [m]
_COMPOUND_SHAPES = 16  # largest number of shapes that createCollisionShapeArray keeps in one body


def connect() -> Any:
    """Return a new client of Bullet, without a window and without the lines that pybullet prints."""
    sys.stdout.flush()
    sys.stderr.flush()
    null = os.open(os.devnull, os.O_WRONLY)
    kept = [(fd, os.dup(fd)) for fd in (1, 2)]
    try:
        for fd, _ in kept:
            os.dup2(null, fd)
        from pybullet_utils.bullet_client import BulletClient

        return BulletClient(sys.modules["pybullet"].DIRECT)
    finally:
        ctypes.CDLL(None).fflush(None)  # The lines may still be in C's buffer of stdout.
        for fd, copy in kept:
            os.dup2(copy, fd)
            os.close(copy)
        os.close(null)


def clear(p: Any, step: float) -> None:
    """Remove everything from the scene of the client `p` except the ground. `step` is the physics step [s]."""
    p.resetSimulation()
    p.setGravity(0, 0, -GRAVITY)
    p.setPhysicsEngineParameter(
        fixedTimeStep=step, numSolverIterations=30, deterministicOverlappingPairs=1, enableFileCaching=0
    )
    ground = p.createMultiBody(0, p.createCollisionShape(p.GEOM_PLANE))
    p.changeDynamics(ground, -1, lateralFriction=0.0)  # wheels.py computes the friction.


def build_obstacles(p: Any, world: World) -> Tuple[List[int], Array]:
    """Create the static obstacles of a world.

    Returns:
        (ids, circles): ids of the bodies, each of which holds several obstacles, and a circle (n, 4) around each
        obstacle: x, y, radius [m], and index of the obstacle's body in `ids`.
    """
    parts = _parts(world)
    numbered = [(k, obstacle) for k, part in enumerate(parts) for obstacle in part]
    circles = [(x, y, radius or math.hypot(*half[:2]), k) for k, (x, y, _, radius, half) in numbered]
    look = p.createVisualShape(p.GEOM_BOX, halfExtents=(0.1, 0.1, 0.1))
    return [_compound(p, part, look) for part in parts], np.array(circles, dtype=float).reshape(-1, 4)


def add_mover(p: Any, mover: Mover) -> int:
    """Create a moving cylinder, whose position the simulator sets at every step."""
    shape = p.createCollisionShape(p.GEOM_CYLINDER, radius=mover.radius, height=OBSTACLE_TOP_M)
    body: int = p.createMultiBody(0, shape, basePosition=(*mover.position(0.0), OBSTACLE_TOP_M / 2))
    p.changeDynamics(body, -1, lateralFriction=1.0)
    return body


def put_mover(p: Any, body: int, x: float, y: float) -> None:
    """Move a moving cylinder to (x, y) [m]."""
    p.resetBasePositionAndOrientation(body, (x, y, OBSTACLE_TOP_M / 2), (0, 0, 0, 1))


def build_robot(p: Any, robot: Robot, pose: Pose) -> int:
    """Create the robot at pose (x, y, yaw), with the driven wheels as joints in the order of geometry.wheel_places.

    The origin of the body's frame is its centre of mass. Casters are fixed spheres that slide on the ground.
    """
    base, body = robot.base, robot.body
    mechanics_of = mechanics(robot)
    com_x, com_y, com_z = mechanics_of.body_com
    length, width, height = body.size
    box = p.createCollisionShape(
        p.GEOM_CYLINDER if body.round else p.GEOM_BOX,
        halfExtents=[length / 2, width / 2, height / 2],
        radius=(length + width) / 4,
        height=height,
        collisionFramePosition=[body.centre[0] - com_x, body.centre[1] - com_y, body.bottom + height / 2 - com_z],
    )
    wheel = p.createCollisionShape(
        p.GEOM_CYLINDER,
        radius=base.wheel_radius,
        height=base.wheel_width,
        collisionFrameOrientation=p.getQuaternionFromEuler([math.pi / 2, 0, 0]),
    )
    n, k = base.wheels, len(base.casters)
    places = [(x - com_x, y - com_y, base.axle_height - com_z) for x, y in geometry.wheel_places(base)]
    shapes = [wheel] * n
    if k:
        radius = max((mechanics_of.base_height + body.bottom) / 2, 0.1 * base.wheel_radius)
        shapes += [p.createCollisionShape(p.GEOM_SPHERE, radius=radius)] * k
        places += [(x - com_x, y - com_y, radius - mechanics_of.base_height - com_z) for x, y in base.casters]
    made: int = p.createMultiBody(
        body.mass - k * CASTER_MASS_KG,
        box,
        -1,
        *_standing(robot, pose),
        linkMasses=[base.wheel_mass] * n + [CASTER_MASS_KG] * k,
        linkCollisionShapeIndices=shapes,
        linkVisualShapeIndices=[-1] * (n + k),
        linkPositions=places,
        linkOrientations=[[0, 0, 0, 1]] * (n + k),
        linkInertialFramePositions=[[0, 0, 0]] * (n + k),
        linkInertialFrameOrientations=[[0, 0, 0, 1]] * (n + k),
        linkParentIndices=[0] * (n + k),
        linkJointTypes=[p.JOINT_REVOLUTE] * n + [p.JOINT_FIXED] * k,
        linkJointAxis=[[0, 1, 0]] * (n + k),
    )

    def dynamics(link: int, inertia: Sequence[float], friction: float, **more: Any) -> None:
        kept = {"linearDamping": 0, "angularDamping": 0, **more}
        p.changeDynamics(made, link, localInertiaDiagonal=inertia, lateralFriction=friction, **kept)

    dynamics(-1, mechanics_of.body_inertia, body.friction)
    ground = robot.simulation
    soft: Any = dict(contactStiffness=ground.ground_stiffness, contactDamping=ground.ground_damping, jointDamping=0)
    kinds = [(mechanics_of.wheel_inertia, base.wheel_friction)] * n + [((1e-8, 1e-8, 1e-8), base.caster_friction)] * k
    for link, kind in enumerate(kinds):
        dynamics(link, *kind, **soft)
    return made


def put_robot(p: Any, body: int, robot: Robot, pose: Pose) -> None:
    """Place the robot of build_robot() at rest at pose (x, y, yaw)."""
    p.resetBasePositionAndOrientation(body, *_standing(robot, pose))
    p.resetBaseVelocity(body, (0, 0, 0), (0, 0, 0))
    for wheel in range(robot.base.wheels):
        p.resetJointState(body, wheel, 0.0, 0.0)


def _standing(robot: Robot, pose: Pose) -> Tuple[Tuple[float, float, float], Tuple[float, ...]]:
    """Return position and attitude of the body's centre of mass for a robot at rest at pose (x, y, yaw)."""
    mechanics_of = mechanics(robot)
    com_x, com_y, com_z = mechanics_of.body_com
    sink = mechanics_of.mass * GRAVITY / len(mechanics_of.supports) / robot.simulation.ground_stiffness
    place = (*transform_point(pose, com_x, com_y), mechanics_of.base_height + com_z - sink)
    return place, quaternion_of(pose[2])


def _parts(world: World) -> List[List[Any]]:
    """Return the static obstacles as (x, y, yaw, radius, half sizes), grouped by position into one list per body.

    A cylinder has no half sizes, and a box has no radius.
    """
    cylinders = np.asarray(world.cylinders, dtype=float).reshape(-1, 3).tolist()
    boxes = np.asarray(world.boxes, dtype=float).reshape(-1, 5).tolist()
    obstacles = [(x, y, 0.0, radius, (0.0, 0.0, 0.0)) for x, y, radius in cylinders]
    obstacles += [(x, y, yaw, 0.0, (dx / 2, dy / 2, OBSTACLE_TOP_M / 2)) for x, y, yaw, dx, dy in boxes]
    obstacles.sort(key=lambda obstacle: (round(obstacle[1]), obstacle[0]))
    return [obstacles[i : i + _COMPOUND_SHAPES] for i in range(0, len(obstacles), _COMPOUND_SHAPES)]


def _compound(p: Any, obstacles: List[Any], look: int) -> int:
    """Create one static body of upright cylinders and boxes with the visual shape `look`, and return its id."""
    shape = p.createCollisionShapeArray(
        shapeTypes=[p.GEOM_CYLINDER if radius else p.GEOM_BOX for _, _, _, radius, _ in obstacles],
        radii=[radius for _, _, _, radius, _ in obstacles],
        lengths=[OBSTACLE_TOP_M] * len(obstacles),
        halfExtents=[half for *_, half in obstacles],
        collisionFramePositions=[(x, y, OBSTACLE_TOP_M / 2) for x, y, *_ in obstacles],
        collisionFrameOrientations=[quaternion_of(yaw) for _, _, yaw, *_ in obstacles],
    )
    body: int = p.createMultiBody(0, shape, look)
    p.changeDynamics(body, -1, lateralFriction=1.0)
    return body
