"""Finds the best single parameter set over the training worlds with CMA-ES: the baseline `static`.

Started as `rosrun applr_ros1 static_search.py` or `python -m training.static_search`. In each generation every
candidate drives through the same newly drawn worlds with the same seeds. At the end the means of the last generations
are driven through all worlds, and the fastest of them is the result.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any, Dict, List, Optional

import numpy as np

import sim_bridge
from applr_ros1.common.arguments import without_remappings
from applr_ros1.common.errors import UsageError, run_main
from applr_ros1.common.files import read_json, write_json
from applr_ros1.planner.variant import DEFAULT_WEIGHTS, DRAWN, OURS, PLANNERS, WEIGHTS
from applr_ros1.policy.parameter_space import SPACE
from training.gorila.actor_pool import InProcess, PoolError, Processes, RayPool
from training.storage import make_folder

FAILURE_SECONDS = 100.0
FINALISTS = 3


class Trials:
    """Drives sets through worlds, in parallel: run() gives the scores."""

    def __init__(self, settings: Dict[str, Any], actors: int, kind: str, address: str, contact_seconds: float):
        self.queue: List[Dict[str, Any]] = []
        self.contact_seconds, self.driven = contact_seconds, 0
        if actors == 0:
            self.pool = InProcess(settings, self._next)
        elif kind == "processes":
            self.pool = Processes(settings, self._next, actors)
        else:
            self.pool = RayPool(settings, self._next, actors, address or None)
        self.pool.publish(0, b"")  # no policy: the tasks say what to drive

    def _next(self, slot):
        return self.queue.pop(0) if self.queue else {"kind": "idle"}

    def run(self, actions: np.ndarray, worlds, seed: int) -> List[Dict[str, Any]]:
        """For each row of actions (k, 8): {score, time_s, success, collided} over all worlds."""
        wanted = {(i, int(w)) for i in range(len(actions)) for w in worlds}
        results: Dict[Any, Dict] = {}
        errors: Dict[str, int] = {}
        since = time.monotonic()
        self.queue[:] = [self._task(actions, i, w, seed) for i, w in sorted(wanted, key=lambda key: key[1])]
        while len(results) < len(wanted):
            for answer in self.pool.poll(0.2):
                content = json.loads(answer[1:])
                task = content.get("task", {})
                if task.get("kind") != "evaluate" or task["seed"] != seed:
                    time.sleep(0.001)
                elif "error" in content:
                    errors[content["error"]] = errors.get(content["error"], 0) + 1
                    if sum(errors.values()) > 20:
                        raise PoolError("trials fail: %s" % content["error"])
                    self.queue.append(task)
                else:
                    results[task["round"], task["world"]] = content
                    since = time.monotonic()
            if time.monotonic() - since > 300.0 and not self.queue:  # actors died with their trials
                self.queue[:] = [self._task(actions, i, w, seed) for i, w in sorted(wanted - set(results))]
                since = time.monotonic()
        self.driven += len(wanted)
        return [self._summary([results[i, int(w)] for w in worlds]) for i in range(len(actions))]

    @staticmethod
    def _task(actions, i, world, seed):
        return {
            "kind": "evaluate",
            "round": i,
            "world": int(world),
            "trial": 0,
            "seed": seed,
            "action": [float(v) for v in actions[i]],
        }

    def _summary(self, results):
        won = [r["time_s"] for r in results if r["success"]]
        seconds = [
            (r["time_s"] if r["success"] else FAILURE_SECONDS) + self.contact_seconds * r["collided"] for r in results
        ]
        return {
            "score": float(np.mean(seconds)),
            "time_s": float(np.mean(won)) if won else None,
            "success": len(won) / len(results),
            "collided": float(np.mean([r["collided"] for r in results])),
            "trials": len(results),
        }


def search(trials: Trials, count: int, options, keep=lambda log: None) -> Dict[str, Any]:
    """CMA-ES. Returns {"theta", "result", "log": [a line per generation], "finalists", ...}. keep(log) is called after
    each generation.
    """
    import cma

    start, log = _start(options.start)
    rng = np.random.default_rng([options.seed, len(log)])
    strategy = cma.CMAEvolutionStrategy(
        np.clip(SPACE.to_action(start), -0.9, 0.9),
        options.sigma,  # not from the very edge of the box
        {"bounds": [-1, 1], "popsize": options.population, "seed": options.seed + 1, "verbose": -9},
    )
    began, last = time.monotonic(), len(log) + options.generations
    for generation in range(len(log), last):
        worlds = np.sort(rng.choice(count, min(count, options.worlds_per_set), replace=False))
        candidates = strategy.ask()
        results = trials.run(np.array(candidates), worlds, seed=options.seed + 1000 + generation)
        strategy.tell(candidates, [r["score"] for r in results])
        best = int(np.argmin([r["score"] for r in results]))
        mean = np.clip(strategy.result.xfavorite, -1.0, 1.0)
        log.append(
            {
                "generation": generation,
                "worlds": worlds.tolist(),
                "sigma": float(strategy.sigma),
                "scores": [round(r["score"], 3) for r in results],
                "best": dict(results[best], **_named(candidates[best])),
                "mean": _named(mean),
                "trials": trials.driven,
                "seconds": round(time.monotonic() - began, 1),
            }
        )
        keep(log)
        print(
            "generation %d of %d: best %.2f s (success %.2f, contact %.2f), median %.2f s, sigma %.3f, "
            "%d trials, %d s"
            % (
                generation + 1,
                last,
                results[best]["score"],
                results[best]["success"],
                results[best]["collided"],
                np.median([r["score"] for r in results]),
                strategy.sigma,
                trials.driven,
                time.monotonic() - began,
            ),
            flush=True,
        )
    finalists = [line["mean"]["theta"] for line in log[-FINALISTS:]] + [log[-1]["best"]["theta"]]
    finalists = [SPACE.theta0.tolist()] + [list(t) for t in dict.fromkeys(map(tuple, finalists))]
    actions = np.array([SPACE.to_action(t) for t in finalists])
    results = trials.run(actions, range(count), seed=options.seed)
    best = 1 + int(np.argmin([r["score"] for r in results[1:]]))
    table = [dict(result, **_named(action)) for action, result in zip(actions, results)]
    print(
        "theta_0: %.2f s; best set: %.2f s, success %.3f, contact %.3f, over %d worlds"
        % (results[0]["score"], results[best]["score"], results[best]["success"], results[best]["collided"], count)
    )
    return {
        "theta": SPACE.as_dict(SPACE.clip(finalists[best])),
        "result": results[best],
        "theta0": results[0],
        "finalists": table,
        "log": log,
        "trials": trials.driven,
        "seconds": round(time.monotonic() - began, 1),
    }


def _start(path: str):
    """(theta, log so far) of an earlier search's log, or (theta, []) of a set, or theta_0."""
    if not path:
        return SPACE.theta0, []
    content = read_json(path)
    if isinstance(content, dict) and content.get("log"):
        return np.array(content["log"][-1]["mean"]["theta"]), list(content["log"])
    return SPACE.read(path), []


def _named(action) -> Dict[str, Any]:
    theta = SPACE.to_theta(action)
    return {"theta": theta.tolist(), "parameters": SPACE.as_dict(theta)}


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(
        prog="static_search.py",
        description=__doc__.splitlines()[0],
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    p.add_argument(
        "--worlds",
        default="generated:train",
        help=(
            "Worlds to search over: generated:N, generated:train, generated:test, fresh:N-M, physical_course, a "
            ".world file or a folder of them; several are separated by commas."
        ),
    )
    p.add_argument("--simulator", default="kinematic", choices=sim_bridge.NAMES, help="Simulator to drive in.")
    p.add_argument(
        "--weights",
        default=DEFAULT_WEIGHTS,
        choices=WEIGHTS + (DRAWN,),
        help="What the distance weights of the planner count, metres or cells; drawn takes one of them in each world "
        "and trial.",
    )
    p.add_argument(
        "--planner",
        default=OURS,
        choices=PLANNERS + (DRAWN,),
        help="Planner to drive with: ours, cpp-like with the defects of the C++ move_base that success depends on, or "
        "drawn for one of them in each world and trial.",
    )
    p.add_argument("--generations", type=int, default=40, help="Number of generations of CMA-ES.")
    p.add_argument("--population", type=int, default=16, help="Number of parameter sets in a generation.")
    p.add_argument(
        "--worlds-per-set", type=int, default=25, help="Number of worlds that each parameter set is driven in."
    )
    p.add_argument(
        "--contact-seconds",
        type=float,
        default=5.0,
        help="Time [s] that a trial with a contact is charged in addition.",
    )
    p.add_argument(
        "--actors",
        type=int,
        default=2,
        help="Number of trials that are driven at the same time; 0 drives them in this process.",
    )
    p.add_argument(
        "--pool",
        default="processes",
        choices=("ray", "processes"),
        help="How trials are driven at the same time: in child processes, or by Ray actors.",
    )
    p.add_argument("--ray-address", default="", help="Address HOST:PORT of a Ray cluster to drive on.")
    p.add_argument(
        "--start",
        default="",
        help=(
            "Where the search begins: a JSON file with a parameter set, or the log of an earlier search, which is "
            "then continued. Without it the search begins at the default parameters, theta_0."
        ),
    )
    p.add_argument(
        "--sigma",
        type=float,
        default=0.5,
        help="Initial standard deviation of the search, with parameters scaled to [-1, 1].",
    )
    p.add_argument("--seed", type=int, default=0, help="Seed of the search and of its trials.")
    p.add_argument(
        "--out",
        default="applr_ros1/models/static.json",
        help="JSON file for the best set, {name: value}. The log is written beside it as NAME_log.json.",
    )
    return p


def main(arguments: Optional[List[str]] = None) -> int:
    """Exit status 0; 1 with one line for a mistake; 130 after Ctrl-C."""
    return run_main(lambda: run(without_remappings(arguments)), "static_search.py")


def run(arguments: List[str]) -> None:
    """Searches as the arguments say and writes the set and its log."""
    options = parser().parse_args(arguments)
    from training.mdp.env import load_worlds

    trials, command = None, "python -m training.static_search " + " ".join(arguments)
    log, partial = (Path(str(Path(options.out).with_suffix("")) + end) for end in ("_log.json", "_partial.json"))
    try:
        if min(options.generations, options.worlds_per_set) < 1 or options.population < 4 or options.actors < 0:
            raise UsageError("--generations and --worlds-per-set must be 1 or more, --population 4 or more")
        if not 0.0 < options.sigma <= 2.0:
            raise UsageError("--sigma is %r: give more than 0, 2 at most" % options.sigma)
        make_folder(Path(options.out).parent)
        count = len(load_worlds(options.worlds))
        settings = {
            "env": "training.mdp.env:ApplrEnv",
            "train": {},
            "evaluate": {
                "worlds": options.worlds,
                "simulator": options.simulator,
                "weights": options.weights,
                "planner": options.planner,
            },
        }
        trials = Trials(settings, options.actors, options.pool, options.ray_address, options.contact_seconds)
        found = search(trials, count, options, lambda lines: write_json(partial, {"command": command, "log": lines}))
        write_json(options.out, found["theta"])
        write_json(log, dict(found, command=command))
        partial.unlink(missing_ok=True)
        print("%s: %s" % (options.out, found["theta"]))
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            "stopped; --start %s goes on from the last generation" % partial
            if partial.exists()
            else "stopped in the first generation; nothing was written"
        ) from None
    finally:
        if trials is not None:
            trials.pool.close()


if __name__ == "__main__":
    sys.exit(main())
