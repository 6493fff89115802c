"""Scenes in which the contacts of both simulators are compared: obstacles about the robot, and what to drive there."""

import numpy as np

from applr_ros1.common.angles import normalize_angle_modulo
from sim_bridge.kinematic_simulator import KinematicSimulator
from tests.support.scenes import STEP, drive, small_world


class Scene:
    """Obstacles about the origin, and what to drive there: of the size of a robot, within its limits.

    seed: of the scene, and of the unevenness of its ground and of the robot's wheels.
    """

    def __init__(self, seed, robot):
        self._seed, rng = seed, np.random.default_rng(seed)
        scale, self._base = robot.world_scale, robot.base
        spots = rng.uniform(-1.1, 1.1, (16, 2))
        cylinders = np.array([(x, y, 0.075) for x, y in spots if max(abs(x) - 0.35, abs(y) - 0.32) > 0])
        boxes = np.empty((0, 5))
        if seed % 3 == 0:  # a wall askew ahead instead of cylinders
            yaw = rng.uniform(-0.7, 0.7)
            cylinders = np.empty((0, 3))
            boxes = np.array([(0.8 + abs(yaw) * 0.5, rng.uniform(-0.4, 0.4), yaw, 0.3, 2.0)])
            boxes *= (scale, scale, 1.0, scale, scale)
        self.world = small_world((cylinders * scale).tolist(), boxes.tolist())
        self.commands = [self._some_command(rng), self._some_command(rng)]
        self._steps = int(round(30 * scale / (self._base.max_speed / 2.0)))  # of each command

    def _some_command(self, rng):
        v, w = self._base.max_speed / 2.0, self._base.max_yaw_rate / 4.0
        if rng.random() < 0.75:
            return v * rng.uniform(0.1, 1.2), w * rng.uniform(-1.5, 1.5)
        return (v * -0.5, 0.0) if rng.random() < 0.3 else (0.0, w * rng.uniform(-2.0, 2.0))

    def drive(self, simulator):
        """Poses (k, 3) every 50 ms, whether there was contact (k,)."""
        simulator.reset(self.world, self._seed)
        poses, touched = [], []
        for v, w in self.commands:
            for _ in range(self._steps):
                state = drive(simulator, v, w, STEP)
                poses.append(state.pose)
                touched.append(state.contact)
        return np.array(poses), np.array(touched)


def compare(robot, scenes, recorded):
    """A row per scene: how far [m, rad] the robots are apart at the end and on average, and which of them touched."""
    simulator = KinematicSimulator(robot)
    rows = []
    for scene, (poses, touched) in zip(scenes, recorded):
        mine, mine_touched = scene.drive(simulator)
        apart = np.hypot(*(mine[:, :2] - poses[:, :2]).T)
        turn = np.abs(normalize_angle_modulo(mine[:, 2] - poses[:, 2]))
        rows.append((apart[-1], turn[-1], apart.mean(), turn.mean(), touched.any(), mine_touched.any()))
    return np.array(rows, dtype=float)
