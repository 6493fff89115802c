"""Bullet's side of the pybullet Jackal: loads pybullet quietly, builds ground, obstacles and robot.

PybulletSimulator uses it.

pybullet's traps, all met here: it prints a banner when imported; it never frees a mesh, so a mesh per world grows
without end; a world of single bodies is several times slower than the same in compounds, and a compound keeps only its
first 16 shapes.
"""

from __future__ import annotations

import ctypes
import math
import os
import sys
from typing import Any, List, Sequence

import numpy as np

from applr_ros1.common.angles import quaternion_of
from worlds import Mover, World

from . import jackal
from .simulator import SimulatorError

GROUND_CONTACT = (3.0e4, 400.0)  # a tyre's stiffness [N/m] and damping [N s/m]
OBSTACLE_TOP = 1.0  # BARN's cylinders reach .5 m; the robot never sees over them
_COMPOUND = 16  # shapes in one body: createCollisionShapeArray drops what is more


def load_pybullet() -> Any:
    """The pybullet module, without its banner."""
    if sys.modules.get("pybullet") is not None:
        return sys.modules["pybullet"]
    sys.stdout.flush()
    sys.stderr.flush()
    null = os.open(os.devnull, os.O_WRONLY)
    kept = [(fd, os.dup(fd)) for fd in (1, 2)]
    try:
        for fd, _ in kept:
            os.dup2(null, fd)
        import pybullet

        ctypes.CDLL(None).fflush(None)  # a banner on stdout would still sit in C's buffer
    except ImportError as error:
        raise SimulatorError(
            "pybullet cannot be imported (%s): pip install pybullet, or take the kinematic simulator" % error
        ) from None
    finally:
        for fd, copy in kept:
            os.dup2(copy, fd)
            os.close(copy)
        os.close(null)
    return pybullet


def build_world(p: Any, client: int, world: World, step: float) -> List[int]:
    """An empty scene with ground and the world's static obstacles. Returns the obstacles' body ids."""
    on = {"physicsClientId": client}
    p.resetSimulation(**on)
    p.setGravity(0, 0, -jackal.GRAVITY, **on)
    p.setPhysicsEngineParameter(
        fixedTimeStep=step, numSolverIterations=30, deterministicOverlappingPairs=1, enableFileCaching=0, **on
    )
    ground = p.createMultiBody(0, p.createCollisionShape(p.GEOM_PLANE, **on), **on)
    p.changeDynamics(ground, -1, lateralFriction=0.0, **on)  # skid_steer.py pulls instead
    return [_compound(p, on, part) for part in _parts(world)]


def add_mover(p: Any, client: int, mover: Mover) -> int:
    """A moving cylinder; the simulator puts it where it is at every step."""
    on = {"physicsClientId": client}
    shape = p.createCollisionShape(p.GEOM_CYLINDER, radius=mover.radius, height=OBSTACLE_TOP, **on)
    body = p.createMultiBody(0, shape, basePosition=_upright(*mover.position(0.0)), **on)
    p.changeDynamics(body, -1, lateralFriction=1.0, **on)
    return body


def put_mover(p: Any, client: int, body: int, x: float, y: float) -> None:
    """Put a moving cylinder at (x, y) [m]."""
    p.resetBasePositionAndOrientation(body, _upright(x, y), (0, 0, 0, 1), physicsClientId=client)


def build_robot(p: Any, client: int, pose: Sequence[float]) -> int:
    """The Jackal at pose (x, y, yaw), its four wheels as joints 0 to 3.

    The body's frame is the chassis's centre of mass.
    """
    on = {"physicsClientId": client}
    com_x, com_y, com_z = jackal.CHASSIS_COM
    length, width, height = jackal.CHASSIS_SIZE
    chassis = p.createCollisionShape(
        p.GEOM_BOX,
        halfExtents=[length / 2, width / 2, height / 2],
        collisionFramePosition=[-com_x, -com_y, height / 2 - com_z],
        **on,
    )
    wheel = p.createCollisionShape(
        p.GEOM_CYLINDER,
        radius=jackal.WHEEL_RADIUS,
        height=jackal.WHEEL_WIDTH,
        collisionFrameOrientation=p.getQuaternionFromEuler([math.pi / 2, 0, 0]),
        **on,
    )
    axles = [
        (i * jackal.WHEELBASE / 2 - com_x, j * jackal.TRACK / 2 - com_y, jackal.AXLE_HEIGHT - com_z)
        for i in (1, -1)
        for j in (1, -1)
    ]
    robot = p.createMultiBody(
        jackal.CHASSIS_MASS,
        chassis,
        -1,
        *_standing(p, pose),
        linkMasses=[jackal.WHEEL_MASS] * 4,
        linkCollisionShapeIndices=[wheel] * 4,
        linkVisualShapeIndices=[-1] * 4,
        linkPositions=axles,
        linkOrientations=[[0, 0, 0, 1]] * 4,
        linkInertialFramePositions=[[0, 0, 0]] * 4,
        linkInertialFrameOrientations=[[0, 0, 0, 1]] * 4,
        linkParentIndices=[0] * 4,
        linkJointTypes=[p.JOINT_REVOLUTE] * 4,
        linkJointAxis=[[0, 1, 0]] * 4,
        **on,
    )
    p.changeDynamics(
        robot,
        -1,
        localInertiaDiagonal=jackal.CHASSIS_INERTIA,
        lateralFriction=jackal.BODY_FRICTION,
        linearDamping=0,
        angularDamping=0,
        **on,
    )
    for wheel in range(4):
        p.changeDynamics(
            robot,
            wheel,
            localInertiaDiagonal=jackal.WHEEL_INERTIA,
            lateralFriction=jackal.WHEEL_FRICTION,
            linearDamping=0,
            angularDamping=0,
            jointDamping=0,
            contactStiffness=GROUND_CONTACT[0],
            contactDamping=GROUND_CONTACT[1],
            **on,
        )
    return robot


def put_robot(p: Any, client: int, robot: int, pose: Sequence[float]) -> None:
    """Put the Jackal at pose (x, y, yaw), standing."""
    on = {"physicsClientId": client}
    p.resetBasePositionAndOrientation(robot, *_standing(p, pose), **on)
    p.resetBaseVelocity(robot, (0, 0, 0), (0, 0, 0), **on)
    for wheel in range(4):
        p.resetJointState(robot, wheel, 0.0, 0.0, **on)


def _standing(p, pose):
    """Position and attitude of the chassis's centre of mass for a robot that stands at pose (x, y, yaw)."""
    x, y, yaw = pose
    com_x, com_y, com_z = jackal.CHASSIS_COM
    c, s = math.cos(yaw), math.sin(yaw)
    sink = jackal.MASS * jackal.GRAVITY / 4 / GROUND_CONTACT[0]
    position = [x + c * com_x - s * com_y, y + s * com_x + c * com_y, jackal.BASE_HEIGHT + com_z - sink]
    return position, p.getQuaternionFromEuler([0, 0, yaw])


def _upright(x, y):
    return (x, y, OBSTACLE_TOP / 2)


def _parts(world):
    """The static obstacles as (x, y, yaw, shape), near ones together, at most _COMPOUND at a time.

    shape: a radius, or (size_x, size_y).
    """
    cylinders = np.asarray(world.cylinders, dtype=float).reshape(-1, 3).tolist()
    boxes = np.asarray(world.boxes, dtype=float).reshape(-1, 5).tolist()
    obstacles = [(x, y, 0.0, radius) for x, y, radius in cylinders]
    obstacles += [(x, y, yaw, (dx, dy)) for x, y, yaw, dx, dy in boxes]
    obstacles.sort(key=lambda obstacle: (round(obstacle[1]), obstacle[0]))
    return [obstacles[i : i + _COMPOUND] for i in range(0, len(obstacles), _COMPOUND)]


def _compound(p, on, obstacles):
    """One standing body of upright cylinders and boxes; its id."""
    round_ones = [not isinstance(shape, tuple) for _, _, _, shape in obstacles]
    shape = p.createCollisionShapeArray(
        shapeTypes=[p.GEOM_CYLINDER if is_round else p.GEOM_BOX for is_round in round_ones],
        radii=[shape if is_round else 0.0 for is_round, (_, _, _, shape) in zip(round_ones, obstacles)],
        lengths=[OBSTACLE_TOP] * len(obstacles),
        halfExtents=[
            (0, 0, 0) if is_round else (shape[0] / 2, shape[1] / 2, OBSTACLE_TOP / 2)
            for is_round, (_, _, _, shape) in zip(round_ones, obstacles)
        ],
        collisionFramePositions=[_upright(x, y) for x, y, _, _ in obstacles],
        collisionFrameOrientations=[quaternion_of(yaw) for _, _, yaw, _ in obstacles],
        **on,
    )
    body = p.createMultiBody(0, shape, **on)
    p.changeDynamics(body, -1, lateralFriction=1.0, **on)
    return body
