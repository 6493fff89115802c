"""Room for a policy on each included robot: `python -m benchmarks.room OUT`.

The figures are for docs/explanation/results.md: times of a robot's tuned set (of its default
parameters if it has none) and of its policy, and the bound of the time. OUT has the evaluations,
which the same command continues.
"""

import sys
from pathlib import Path

import pandas as pd

from applr_ros1 import robots
from applr_ros1.policy import methods
from training.evaluate.bound import bound_s
from training.evaluate.evaluation import EvaluationOptions, evaluate
from training.evaluate.runner import world_list
from training.evaluate.verdict import DRIVE, paired_trials

WORLDS = ("fresh:20100-20149", "dynamic:400-419")


def rows_of(robot, worlds, out):
    """Yield a row for each method of a robot, with means over the drives in which all arrive."""
    has_set = Path(methods.shipped(methods.SET, robot)).exists()
    tuned = "static" if has_set else "dwa"
    chosen = list(dict.fromkeys([tuned, methods.auto(robot)]))
    options = EvaluationOptions(
        robot=robot,
        worlds=worlds,
        methods=",".join(chosen),
        trials=1,
        simulator="pybullet",
        protocol="barn-challenge",
        monitor=True,
        movers=True,
        workers=2,
        out=f"{out}/{robot.name}_{worlds.replace(':', '_')}",
    )
    trials = paired_trials(evaluate(options), chosen)
    listed = world_list(worlds, options.protocol, robot)
    bounds = {name: bound_s(world, robot) for name, _, world in listed}

    all_arrive = trials[trials.groupby(DRIVE).success.transform("all")]
    bound = all_arrive.world.map(bounds).mean()
    times = all_arrive.groupby("method").time_s.mean().reindex(chosen)
    tuned_room = times[tuned] - bound
    for method in chosen:
        success = trials.success[trials.method == method]
        yield {
            "robot": robot.name,
            "worlds": worlds,
            "method": method,
            "arrived": f"{success.sum()} of {len(success)}",
            "time [s]": times[method],
            "bound [s]": bound,
            "time / bound": times[method] / bound,
            "room taken": 1.0 - (times[method] - bound) / tuned_room,
        }


def main():
    """Print the table."""
    rows = []
    for name in robots.NAMES:
        for worlds in WORLDS:
            rows += rows_of(robots.load(name), worlds, sys.argv[1])
    print(pd.DataFrame(rows).round(2).to_csv(index=False))


if __name__ == "__main__":
    main()
