"""Finds the best single parameter set over the training worlds with CMA-ES and races: the baseline `static`.

Started as `rosrun applr_ros1 static_search.py` or `python -m training.static_search`. In each generation the candidates
race through the same newly drawn worlds with the same seeds, and CMA-ES is given their ranks. At the end theta_0, the
given sets, and the means and winners of the last generations race through other worlds. A search that was stopped
continues with the same command and comes to the same result.
"""

from __future__ import annotations

import shlex
import sys
import time
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Callable, Dict, Iterator, List, Literal, Mapping, Optional, Sequence, Tuple, TypeVar

import numpy as np
import yaml

from applr_ros1.common.arguments import without_remappings
from applr_ros1.common.errors import ApplrError, reason, run_main
from applr_ros1.common.extras import extra
from applr_ros1.common.files import read_json, write_bytes, write_json
from applr_ros1.common.trees import branch
from applr_ros1.planner.variant import OURS
from applr_ros1.policy.parameter_space import SPACE, Space, space_of
from applr_ros1.robots import Robot
from training.actors.pool import make_pool
from training.common.command_line import (
    AnyRobot,
    ContactSeconds,
    Monitor,
    Planner,
    ProtocolName,
    RayAddress,
    Seed,
    SimulatorName,
    Workers,
    continuable,
    parsed,
)
from training.common.folders import make_folder
from training.common.options import Options, option
from training.env.settings import TrialSettings
from training.evaluation.periodic import CHOOSING
from training.evaluation.plan import Trial, TrialResult, seed_of
from training.evaluation.score import CONTACT_SECONDS, barn_metric, clearly_worse, summary, trial_seconds
from training.evaluation.store import TrialTable
from training.evaluation.trials import content, drive, drive_missing, world_list
from worlds.loading import FORMS

with extra(__name__):
    import cma

FINALISTS = 5  # generations whose means and winners take part in the last race
FINAL_BLOCK = 8  # trials between two tests of the last race

Job = Tuple[int, int]  # index of a world, number of the trial there
DriveTrials = Callable[[Sequence[Trial]], Dict[Trial, TrialResult]]  # evaluation.trials.drive_missing
Found = TypeVar("Found")


class StaticOptions(Options):
    """Where and how to search."""

    # fmt: off
    worlds: str = option("generated:learn", f"Worlds to search over: {FORMS}; several are separated by commas.")
    robot: AnyRobot
    simulator: SimulatorName = "kinematic"
    planner: Planner
    protocol: ProtocolName
    monitor: Monitor
    workers: Workers
    ray_address: RayAddress
    start: List[str] = option([],
        "JSON file with a parameter set, or the log of an earlier search, that takes part in the first generation and "
        "in the last race; may be given several times. The search begins around the first. Without it the search "
        "begins at the default parameters, theta_0.")
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
    seed: Seed
    objective: Literal["score", "metric"] = option("score",
        "What is searched for: the smallest score, the time in seconds of a trial with 100 s for a failure; or the "
        "largest BARN metric, success x OT / clip(time, 2 OT, 8 OT), where OT is the reference path over 2 m/s.")
    contact_seconds: ContactSeconds = CONTACT_SECONDS
    final_worlds: str = option("generated:validation",
        f"Worlds of the last race: {FORMS}; several are separated by commas.")
    final_simulator: SimulatorName = option("pybullet", "Simulator of the last race.")
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
    options = parsed(StaticOptions, "static_search.py", (__doc__ or "").splitlines()[0], arguments)
    stem = str(Path(options.out).with_suffix(""))
    make_folder(Path(options.out).parent)
    worlds, final_worlds = (
        [w[:2] for w in world_list(text, options.protocol, options.robot)]
        for text in (options.worlds, options.final_worlds)
    )
    space = space_of(options.robot)
    starts = [start(path, space) for path in options.start] or [space.theta0]
    began = time.monotonic()

    @contextmanager
    def driver(worlds: List[Tuple[str, str]], simulator: str, planner_frequency: Optional[int]) -> Iterator[SetTrials]:
        rules: Dict[str, Any] = {"simulator": simulator, "protocol": options.protocol, "monitor": options.monitor}
        made = TrialSettings(**rules, planner_frequency=planner_frequency, robot=options.robot.folder)
        table = TrialTable(stem + "_trials.csv", [*rules.values(), planner_frequency, content(options.robot)])
        with make_pool(options.workers, options.ray_address) as pool:
            found = partial(drive_missing, pool, partial(drive, made), table=table)
            yield SetTrials(found, worlds, space, options.planner)

    with continuable():
        with driver(worlds, options.simulator, options.planner_frequency) as trials:
            log = search(trials, starts, options)
        with driver(final_worlds, options.final_simulator, None) as last:
            table = last_race(last, finalists(space, starts, log), options)
    best = table[0]["parameters"]
    found = {
        "theta": best,
        "result": table[0],
        "finalists": table,
        "log": log,
        "trials": trials.driven + last.driven,
        "seconds": round(time.monotonic() - began, 1),
        "command": shlex.join(["python", "-m", "training.static_search", *arguments]),
    }
    write_json(options.out, {"meter_scoring": False, "parameters": best})
    write_json(stem + "_log.json", found)
    print(f"{options.out}: {best}")
    write_bytes(stem + ".yaml", yaml.safe_dump(move_base_parameters(options.robot, best)).encode())
    print(f"{stem}.yaml: the same for move_base, to be loaded after {options.robot.name}'s own files")


class SetTrials:
    """Drives sets of a robot's parameters through worlds.

    Args:
        drive: gives the results of trials.
        worlds: [(name, specification), ...].
        space: of the sets.
        planner: kind of planner (applr_ros1/planner/variant.py).
    """

    def __init__(self, drive: DriveTrials, worlds: Sequence[Tuple[str, str]], space: Space, planner: str = OURS):
        self.drive, self.worlds, self.space, self.planner = drive, worlds, space, planner
        self.driven = 0  # trials, those of the table included

    def run(self, sets: np.ndarray, jobs: Sequence[Job], seed: int) -> List[List[TrialResult]]:
        """Each set (k, n) in each job, which all drive with the same seed: a list of results for each set.

        Raises:
            ApplrError: where a trial fails by an error.
        """
        trials = [[self.trial(theta, world, number, seed) for world, number in jobs] for theta in sets]
        results = self.drive([trial for of_job in zip(*trials) for trial in of_job])  # equal sets drive once
        self.driven += len(results)
        return [[results[trial] for trial in of_set] for of_set in trials]

    def trial(self, values: np.ndarray, world: int, number: int, seed: int) -> Trial:
        """The trial of a set in a job; evaluate.py's trials have other seeds."""
        name, spec = self.worlds[world]
        theta = tuple(float(value) for value in self.space.clip(values))
        seed = seed_of(CHOOSING + seed, name, number)
        return Trial(name, "set", number, seed, spec, "", self.planner, theta=theta)


def search(trials: SetTrials, starts: Sequence[np.ndarray], options: StaticOptions) -> List[Dict[str, Any]]:
    """The generations of CMA-ES.

    Args:
        trials: drives the candidates.
        starts: sets (n,), at least one. The distribution begins around the first; all take part in the first
            generation.
        options: of the search.

    Returns:
        A dict of JSON values for each generation, with its "winner" and the "mean" of the distribution after it.
    """
    rng, space = np.random.default_rng(options.seed), trials.space
    strategy = cma.CMAEvolutionStrategy(
        np.clip(space.to_action(starts[0]), -0.9, 0.9),  # not from the very edge of the box
        options.sigma,
        {"bounds": [-1, 1], "popsize": options.population, "seed": options.seed + 1, "verbose": -9},
    )
    began, log = time.monotonic(), []
    for generation in range(options.generations):
        drawn = rng.permutation(len(trials.worlds))[: options.worlds_per_set].tolist()
        candidates = strategy.ask()
        sets = np.array([space.to_theta(action) for action in candidates])
        if generation == 0:
            for i, theta in enumerate(starts[: len(candidates)]):
                candidates[i], sets[i] = space.to_action(theta), space.clip(theta)
        quarter, half = -(-len(drawn) // 4), -(-len(drawn) // 2)
        parts = drawn[:quarter], drawn[quarter:half], drawn[half:]
        blocks = [[(world, 0) for world in part] for part in parts if part]
        drive = partial(trials.run, seed=options.seed + 1000 + generation)
        ranking, results = race(drive, sets, blocks, options.cost, halve=True)
        strategy.tell(candidates, np.argsort(ranking).astype(float).tolist())
        winner = _line(space, sets[ranking[0]], results[ranking[0]], options.contact_seconds)
        seconds = round(time.monotonic() - began, 1)
        log.append(
            {
                "generation": generation,
                "worlds": drawn,
                "sigma": float(strategy.sigma),
                "scores": [round(float(np.mean([options.cost(result) for result in found])), 3) for found in results],
                "winner": winner,
                "mean": {"theta": space.to_theta(np.clip(strategy.result.xfavorite, -1.0, 1.0)).tolist()},
                "trials": trials.driven,
                "seconds": seconds,
            }
        )
        where = f"generation {generation + 1} of {options.generations}: winner {_summary(winner)}"
        print(f"{where}, sigma {strategy.sigma:.3f}, {trials.driven} trials in all, {seconds:.0f} s", flush=True)
    return log


def finalists(space: Space, starts: Sequence[np.ndarray], log: List[Dict[str, Any]]) -> np.ndarray:
    """Sets (k, n) for the last race, each once: theta_0, the given ones, means and winners of the last generations."""
    found = [space.theta0, *(space.clip(theta) for theta in starts)]
    found += [line[which]["theta"] for line in log[-FINALISTS:] for which in ("mean", "winner")]
    return np.array(list(dict.fromkeys(tuple(float(value) for value in theta) for theta in found)))


def last_race(trials: SetTrials, sets: np.ndarray, options: StaticOptions) -> List[Dict[str, Any]]:
    """Races sets (k, n) options.final_trials times through each world: JSON values of each, the best first."""
    order = np.random.default_rng(options.seed).permutation(len(trials.worlds)).tolist()
    jobs = [(world, trial) for trial in range(options.final_trials) for world in order]
    blocks = [jobs[i : i + FINAL_BLOCK] for i in range(0, len(jobs), FINAL_BLOCK)]
    ranking, results = race(partial(trials.run, seed=options.seed), sets, blocks, options.cost)
    table = [_line(trials.space, sets[i], results[i], options.contact_seconds) for i in ranking]
    for line in table:
        print(f"{_summary(line)}: {line['parameters']}", flush=True)
    return table


def race(
    drive: Callable[[np.ndarray, Sequence[Job]], Sequence[Sequence[Found]]],
    sets: np.ndarray,
    blocks: Sequence[Sequence[Job]],
    cost: Callable[[Found], float],
    halve: bool = False,
) -> Tuple[List[int], List[List[Found]]]:
    """Races sets (k, n) through the same trials, block after block.

    After each block those drop out that a paired test finds clearly worse than the leader (the idea of F-race).

    Args:
        drive: gives the results of each of those sets that are still in the race in the trials of a block.
        sets: at least one.
        blocks: trials in the order in which they are added.
        cost: of a result; small is good.
        halve: whether at most half of the candidates, rounded up, stay after each block (successive halving).

    Returns:
        The sets' indices, the best first: whoever stayed longer comes before whoever dropped out earlier, and those of
        one block are ordered by their mean cost. The results of each, in the order of the trials.
    """
    results: List[List[Found]] = [[] for _ in sets]
    racing: List[int] = list(range(len(sets)))
    dropped: List[int] = []
    for number, block in enumerate(blocks, start=1):
        for i, more in zip(racing, drive(sets[racing], block)):
            results[i] += more
        costs = {i: np.array([cost(result) for result in results[i]]) for i in racing}
        racing.sort(key=lambda i: float(costs[i].mean()))
        if number < len(blocks):
            leader = racing[0]
            staying = [i for i in racing if i == leader or not clearly_worse(costs[i], costs[leader])]
            if halve:
                staying = staying[: -(-len(racing) // 2)]
            dropped = [i for i in racing if i not in staying] + dropped
            racing = staying
        if len(racing) == 1:
            break
    return racing + dropped, results


def _line(space: Space, theta: np.ndarray, results: List[TrialResult], contact_seconds: float) -> Dict[str, Any]:
    found = summary(results, contact_seconds)
    names = ("score", "metric", "time_s", "success", "collided", "trials")
    return {**{name: found[name] for name in names}, "theta": theta.tolist(), "parameters": space.as_dict(theta)}


def _summary(line: Dict[str, Any]) -> str:
    return (
        f"{line['score']:.2f} s in {line['trials']} trials (success {line['success']:.3f}, contact "
        f"{line['collided']:.3f}, metric {line['metric']:.3f})"
    )


def move_base_parameters(robot: Robot, values: Mapping[str, Any]) -> Dict[str, Any]:
    """A set as the nested parameters of move_base that, loaded after the robot's own files, replace theirs.

    They have the names and places of those files, which may be older ones (robots.description.find).

    Args:
        robot: The robot.
        values: {name: value} of the set.
    """
    made: Dict[str, Any] = {}
    space, own = space_of(robot), robot.parameters()
    for server, request in space.requests(space.from_dict(dict(values))).items():
        costmap = server.rpartition("/")[0]
        place = costmap if costmap and "plugins" not in branch(own, costmap) else server
        for _, target in space.targets_of(server):
            names = [name for name in target.names if name in branch(own, place)] or target.names[:1]
            branch(made, place, create=True).update(dict.fromkeys(names, request[target.names[0]]))
    return made


def start(path: str, space: Space = SPACE) -> np.ndarray:
    """The set (n,) in a JSON file: one set, or the one that an earlier search found, by its log."""
    content = read_json(path)
    if isinstance(content, dict) and "theta" in content:
        try:
            return space.from_dict(dict(content["theta"]))
        except (TypeError, ValueError) as error:
            raise ApplrError(f"--start {path}: no set of parameters ({reason(error)})") from None
    return space.read(path)


if __name__ == "__main__":
    sys.exit(main())
