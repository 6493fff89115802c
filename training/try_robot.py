"""Whether the included policy pays on a robot: drives courses in simulation and ends with a verdict.

Started as `./applr try ROBOT` or `python -m training.try_robot ROBOT`. It begins on open floor: where a robot's own
parameters do not drive it, its set-up is wrong, and what is printed says why and what to change. In each course the
robot's own parameters, the policy and, where the robot's folder has static.json, the tuned parameters drive with the
same seed, until one of them is clearly better or the time is spent. What is printed then ends with three sentences
(arrivals and times with 95 % intervals; whether the policy pays; what to do next), the commonest reasons of failures, a
picture, and the line for robot.yaml. The exit status is 0 only where the policy pays. A stopped run continues with the
same command.
"""

from __future__ import annotations

import os
import sys
import time
from functools import partial
from pathlib import Path
from typing import Iterator, List, Optional, Sequence

from pydantic import Field

from applr_ros1.common.errors import run_main
from applr_ros1.common.extras import absent
from applr_ros1.policy import methods
from training.common import command_line
from training.common.options import PLACE, Options, option
from training.evaluation import open_floor
from training.evaluation.plan import Trial
from training.evaluation.run import EvaluationOptions, evaluate
from training.evaluation.store import TrialStore
from training.evaluation.trials import TRIAL_RUNNER
from training.report.verdict import (
    LOOKS,
    OWN,
    POLICY,
    SET,
    decided,
    failures,
    mean_scores,
    paired_trials,
    picture,
    verdict,
)

TRIALS = 3  # of each method in each world, at most


class TryOptions(Options):
    """What to try."""

    # fmt: off
    robot: command_line.AnyRobot = Field(
        description="Folder with robot.yaml, or the name of an included robot.", json_schema_extra=PLACE)
    minutes: float = option(5.0, "Time [min] after the first course in which others are begun.", gt=0, le=10_000)
    worlds: command_line.WorldNames = "generated:validation"
    simulator: command_line.SimulatorName = "kinematic"
    workers: command_line.Workers
    out: str = option("",
        "Folder for trials.csv, driven paths and the picture; drives in it are continued. Default: try/ROBOT.")
    seed: command_line.Seed
    runner: str = option(TRIAL_RUNNER, "")  # tests give a toy
    # fmt: on


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Exit status 0 where the policy pays; 1 where it does not, or with one line for a mistake; 130 after Ctrl-C."""
    command_line.end_at_sigterm()
    name = "./applr try"
    return run_main(lambda: run(command_line.parsed(TryOptions, name, __doc__, arguments)), name)


def run(options: TryOptions) -> int:
    """Drives and prints the verdict; returns the exit status."""
    robot = options.robot
    drives, lines = open_floor.sentences(robot, options.simulator)
    print("\n".join(lines))
    if not drives:
        return 1
    names = [OWN, POLICY, *([SET] if os.path.exists(methods.shipped("static.json", robot)) else [])]
    how = {name: getattr(options, name) for name in ("robot", "worlds", "simulator", "workers", "seed", "runner")}
    out = options.out or os.path.join("try", robot.name)
    evaluation = EvaluationOptions.model_construct(
        **how, methods=",".join(names), trials=TRIALS, protocol="paper", monitor=True, movers=True, out=out
    )
    blocks = partial(_blocks, names=names, pairs=max(1, options.workers), seconds=60.0 * options.minutes)
    with command_line.continuable():
        store = evaluate(evaluation, blocks)
    driven, used_up = paired_trials(store.results, names), len(store.results) == len(store.plan)
    method, sentences = verdict(driven, robot.name, robot.folder, used_up)
    path, missing = Path(out) / "verdict.png", absent("matplotlib")
    if not missing:
        picture(mean_scores(driven), robot.name, path)
    print("\n".join([*sentences, *failures(driven), f"picture: {missing or path}", "line for robot.yaml:"]))
    print(f"method: {method}")
    return 0 if method == POLICY else 1


def _blocks(store: TrialStore, names: Sequence[str], pairs: int, seconds: float) -> Iterator[List[Trial]]:
    """So many courses at a time with all methods, until it is clear which is best or the time is spent.

    The time begins after the first, in which kernels may be compiled.
    """
    looks, until = list(LOOKS), 0.0
    for first in range(0, len(store.plan), pairs * len(names)):
        count = first // len(names)
        if looks and count >= looks[0]:
            looks.pop(0)
            so_far = {trial: store.results[trial] for trial in store.plan[:first]}
            if decided(mean_scores(paired_trials(so_far, names))):
                return
        block = list(store.plan[first : first + pairs * len(names)])
        if first and time.monotonic() > until and not all(trial in store.results for trial in block):
            return
        yield block
        until = until or time.monotonic() + seconds


if __name__ == "__main__":
    sys.exit(main())
