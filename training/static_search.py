"""Finds the best single parameter set over the training worlds with CMA-ES and races: the baseline `static`.

Started as `rosrun applr_ros1 static_search.py` or `python -m training.static_search`. In each generation the candidates
race through the same newly drawn worlds with the same seeds, and CMA-ES is given their ranks. At the end theta_0, the
given sets, and the means of the last generations race through other worlds. A search that was stopped continues with
the same command and comes to the same result.
"""

from __future__ import annotations

import shlex
import sys
from functools import partial
from itertools import repeat
from pathlib import Path
from typing import Any, Dict, List, Literal, Optional

from applr_ros1.common.arguments import without_remappings
from applr_ros1.common.errors import run_main
from applr_ros1.common.extras import extra
from applr_ros1.common.files import write_json
from applr_ros1.policy.parameter_space import space_of
from training.actors.pool import make_pool
from training.common import command_line
from training.common.folders import make_folder
from training.common.options import Options, option
from training.env.settings import TrialSettings
from training.evaluation.plan import TrialResult
from training.evaluation.score import CONTACT_SECONDS, barn_metric, trial_seconds
from training.evaluation.trials import world_list
from training.tune import parameter_file
from worlds.loading import FORMS

with extra(__name__):
    from training.tune.search import SetTrials, blocks_of, finalists, last_race, said, search


class StaticOptions(Options):
    """Where and how to search."""

    # fmt: off
    worlds: str = option("generated:learn", f"Worlds to search over: {FORMS}; several are separated by commas.")
    robot: command_line.AnyRobot
    simulator: command_line.SimulatorName = "kinematic"
    planner: command_line.Planner
    protocol: command_line.ProtocolName
    monitor: command_line.Monitor
    workers: command_line.Workers
    ray_address: command_line.RayAddress
    start: List[str] = option([],
        "JSON file with a parameter set that takes part in the first generation and in the last race; may be given "
        "several times. The search begins around the first. Default: the default parameters, theta_0.")
    planner_frequency: Optional[int] = option(None,
        "Global plans per simulated second during the generations. 10 or 5 make the search faster and less exact; the "
        "last race plans as often as the robot does. Default: as often as the robot does.", ge=1, le=20)
    generations: int = option(40, "Number of generations of CMA-ES.", ge=1, le=10**6)
    population: int = option(16, "Number of parameter sets in a generation.", ge=4, le=10**6)
    worlds_per_set: int = option(24,
        "Number of worlds that a generation races in: all sets drive a quarter of them, the better half another "
        "quarter, and the better half of those the rest.", ge=1, le=10**6)
    sigma: float = option(0.5,
        "Initial standard deviation of the search, with parameters scaled to [-1, 1].", ge=1e-3, le=2)
    seed: command_line.Seed
    objective: Literal["score", "metric"] = option("score",
        "What is searched for: the smallest score, the time in seconds of a trial with 100 s for a failure; or the "
        "largest BARN metric, success x OT / clip(time, 2 OT, 8 OT), where OT is the reference path over 2 m/s.")
    contact_seconds: command_line.ContactSeconds = CONTACT_SECONDS
    final_worlds: str = option("generated:validation",
        f"Worlds of the last race: {FORMS}; several are separated by commas.")
    final_simulator: command_line.SimulatorName = option("pybullet", "Simulator of the last race.")
    final_trials: int = option(2, "Number of trials in each world of the last race.", ge=1, le=1000)
    out: str = option("applr_ros1/robots/jackal/static.json",
        'JSON file for the best set: {"meter_scoring": false, "parameters": {NAME: VALUE}}; its distance biases count '
        "per cell. Beside it, NAME_log.json takes the log and NAME_trials.csv every trial, from which a stopped "
        "search continues. NAME.yaml holds the same set as parameters of move_base, to be loaded after the robot's own "
        "files.")
    # fmt: on

    def cost(self, result: TrialResult) -> float:
        """What is made small: a trial's score [s], or its negated metric."""
        if self.objective == "metric":
            return -float(barn_metric(result.success, result.collided, result.time_s, result.route_m))
        return trial_seconds(result.success, result.time_s, result.collided, self.contact_seconds)


def main(arguments: Optional[List[str]] = None) -> int:
    """Exit status 0; 1 with one line for a mistake; 130 after Ctrl-C."""
    return run_main(lambda: run(without_remappings(arguments)), "static_search.py")


def run(arguments: List[str]) -> None:
    """Searches as the arguments say and writes the set and its log."""
    options = command_line.parsed(StaticOptions, "static_search.py", (__doc__ or "").splitlines()[0], arguments)
    robot, space, stem = options.robot, space_of(options.robot), Path(options.out).with_suffix("")
    make_folder(stem.parent)
    worlds, final_worlds = (
        [world[:2] for world in world_list(text, options.protocol, robot)]
        for text in (options.worlds, options.final_worlds)
    )
    starts = [space.read(path) for path in options.start] or [space.theta0]
    log: List[Dict[str, Any]] = []
    how = {name: getattr(options, name) for name in ("seed", "sigma", "population", "worlds_per_set")}
    rules: Dict[str, Any] = {"protocol": options.protocol, "monitor": options.monitor, "robot": robot.folder}
    first = TrialSettings(simulator=options.simulator, planner_frequency=options.planner_frequency, **rules)
    last = TrialSettings(simulator=options.final_simulator, **rules)
    with command_line.continuable(), make_pool(options.workers, options.ray_address) as pool:
        table = Path(f"{stem}_trials.csv")
        made = partial(SetTrials.kept, pool, robot, table=table, planner=options.planner)
        rounds = repeat(made(worlds, settings=first), options.generations)
        for line in search(rounds, starts, options.cost, **how):
            log.append(line)
            where = f"generation {len(log)} of {options.generations}: winner {said(line['winner'])}"
            print(f"{where}, sigma {line['sigma']:.3f}", flush=True)
        blocks = blocks_of(len(final_worlds), options.final_trials, options.seed)
        sets = finalists(space, starts, log)
        lines = last_race(made(final_worlds, settings=last), sets, blocks, options.cost, options.seed)
    for line in lines:
        print(f"{said(line)}: {line['parameters']}", flush=True)
    command = shlex.join(["python", "-m", "training.static_search", *arguments])
    write_json(f"{stem}_log.json", {"result": lines[0], "finalists": lines, "log": log, "command": command})
    best = lines[0]["parameters"]
    parameter_file.write(robot, best, Path(options.out), Path(f"{stem}.yaml"))
    print(f"{options.out}: {best}")
    print(f"{stem}.yaml: the same for move_base, to be loaded after {robot.name}'s own files")


if __name__ == "__main__":
    sys.exit(main())
