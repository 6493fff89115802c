#!/usr/bin/env python3
"""What fewer global plans per second change in the drives: `python tests/benchmarks/planner_frequency.py [--worlds N]`.

Drives the default parameters, the best single set and the included policy in the environment that training uses, at
20, 10 and 5 plans per simulated second of the environment, with the same worlds and seeds. Prints a row for
each: success rate, mean time of the successes, the ratio of it to 20 Hz, and the processor time per simulated second.
"""

import argparse
import sys
from pathlib import Path
from time import process_time

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import worlds
from applr_ros1.planner.warm_up import warm_up
from applr_ros1.policy.actor import Actor
from applr_ros1.policy.parameter_space import SPACE
from training.env.env import ApplrEnv

MODELS = Path(__file__).resolve().parents[2] / "applr_ros1" / "models"


def policies():
    """{name: function from an observation (729,) to an action (8,)}."""
    default = SPACE.to_action(SPACE.theta0)
    static = SPACE.to_action(SPACE.read(MODELS / "static.json"))
    actor = Actor.load(MODELS / "applr.safetensors")
    return {"dwa": lambda observation: default, "static": lambda observation: static, "applr": actor.action}


def drive(env, act, names, trials):
    """(success (n,), time [s] (n,), processor seconds per simulated second) of every world and trial."""
    found, simulated, began = [], 0.0, process_time()
    for trial in range(trials):
        for number, name in enumerate(names):
            observation, info = env.reset(seed=1000 * trial + number, options={"world": name})
            over = False
            while not over:
                observation, _, terminated, truncated, info = env.step(act(observation))
                simulated += env.episode.outcome.seconds
                over = terminated or truncated
            found.append((info["success"], info["time_s"]))
    success, time = np.array(found).T
    return success > 0, time, (process_time() - began) / simulated


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--worlds", type=int, default=25, help="Number of validation worlds. Default: 25.")
    parser.add_argument("--trials", type=int, default=2, help="Trials in each world. Default: 2.")
    options = parser.parse_args()
    warm_up()
    courses = worlds.load_all("generated:validation")
    courses = [courses[i] for i in np.linspace(0, len(courses) - 1, options.worlds).astype(int)]
    environments = {hertz: ApplrEnv(courses, planner_frequency=hertz) for hertz in (20, 10, 5)}
    print("%-10s %6s %9s %9s %9s %14s" % ("method", "Hz", "success", "time [s]", "to 20 Hz", "CPU s per s"))
    for name, act in policies().items():
        usual = None
        for hertz, env in environments.items():
            success, time, cost = drive(env, act, [w.name for w in courses], options.trials)
            mean = time[success].mean()
            usual = usual or mean
            print("%-10s %6d %9.3f %9.2f %9.3f %14.4f" % (name, hertz, success.mean(), mean, mean / usual, cost))


if __name__ == "__main__":
    main()
