#!/usr/bin/env python3
"""What a policy for every robot brings to robots that it has not met: `python tests/benchmarks/drawn_robots.py`.

Robots are drawn as in training, with other seeds. Each drives 16 validation worlds at its scale once with its maker's
parameters and once with the policy, in the kinematic simulator with the collision monitor.
"""

import argparse
from unittest import mock

import numpy as np

import worlds
from applr_ros1.policy import methods
from training.env import drawn_robots
from training.evaluation import trials

SEED = 77


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--policy", default=methods.shipped(), help="Policy file. Default: the included one.")
    parser.add_argument("--robots", type=int, default=5, help="Number of robots. Default: 5.")
    options = parser.parse_args()
    courses = [(world, world) for world in worlds.specs("generated:validation")[:16]]
    print("robot  width  speed  drive       method  arrived  time [s]  contacts")
    for number in range(options.robots):
        robot = drawn_robots.draw_another(np.random.default_rng([SEED, number]))
        with mock.patch.object(trials, "load", lambda _, robot=robot: robot):
            runner = trials.TrialRunner("kinematic", monitor=True)
        for method, spec in (("dwa", "dwa"), ("policy", options.policy)):
            results = [runner.run(task).result for task in trials.plan(courses, [(method, spec)], 1, seed=0)]
            times = [result.time_s for result in results if result.success]
            print(
                "%5d  %5.2f  %5.2f  %-10s  %-6s  %4d/%2d  %8.1f  %8d"
                % (
                    *(number, robot.body.size[1], robot.base.max_speed, robot.base.drive, method),
                    *(len(times), len(results), np.mean(times), sum(result.collided for result in results)),
                ),
                flush=True,
            )


if __name__ == "__main__":
    main()
