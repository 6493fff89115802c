"""Shifts the last layer of a learnt policy to where it drives best, by driving alone, and writes a policy file.

Started as `python -m training.refine_policy POLICY.safetensors --out FILE.safetensors`. In each world the policy drives
twice with the same seed: with random numbers added to the weights and biases of its last layer, and with the same
numbers subtracted. After each step, a regression over all pairs of the search says which shift is expected to be best;
the next step searches around it. A search that was stopped continues with the same command.
"""

from __future__ import annotations

import sys
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any, Dict, Optional, Sequence

import numpy as np

from applr_ros1.common.errors import ApplrError, run_main
from applr_ros1.common.files import read_bytes, sha256
from applr_ros1.common.tensors import checksum
from applr_ros1.policy.actor import Actor, save
from applr_ros1.policy.network import Mirror
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots import JACKAL
from training.actors.tasks import RunnerSpec, Trial
from training.common.command_line import (
    AnyRobot,
    Monitor,
    Planner,
    SimulatorName,
    Workers,
    continuable,
    end_at_sigterm,
    parsed,
)
from training.common.folders import Lock, make_folder
from training.common.options import argument, option
from training.common.provenance import without_folders
from training.evaluation.periodic import CHOOSING
from training.evaluation.remembered import RememberedTrials
from training.evaluation.store import TABLE, TrialTable
from training.evaluation.trials import seed_of
from training.policy_file import stated, weights_of
from training.refinement.directions import Directions
from training.refinement.driving import SHIFTED_RUNNER, ShiftedRunner, known_directions, write_directions
from training.refinement.search import SearchOptions, Step, search
from worlds import Worlds
from worlds.loading import FORMS

SEARCHED = (  # options of the search that the file states
    *("worlds", "simulator", "planner", "monitor"),
    *("steps", "pairs", "components", "sigma", "limit", "contact_seconds", "seed"),
)
DRIVEN = ("simulator", "period", "time_limit", "monitor", "robot")  # options of the runner that tell drives apart
WATCHED = 60  # worlds that the policy drives first, for the directions


class RefineOptions(SearchOptions):
    """What to refine, and where."""

    # fmt: off
    policy: str = argument("Policy file to begin with, as train.py writes it.")
    out: str = option(..., "File to write the shifted policy to; rewritten after each step.")
    worlds: str = option("fresh:100000-108059",
        f"Worlds to drive in, one after the other; each is used once: {FORMS}; several are separated by commas.")
    robot: AnyRobot
    simulator: SimulatorName = "pybullet"
    planner: Planner
    monitor: Monitor
    period: Optional[float] = option(None,
        "Decision period [s] that the policy is driven with, and that the file then states. Default: the one that the "
        "policy's file states.", ge=0.05, le=10)
    components: int = option(3,
        "Number of principal components of the last hidden layer whose weights are searched; 0 searches biases only.",
        ge=0, le=64)
    workers: Workers
    results: str = option("results/refinement",
        "Folder for the directions and for every drive, from which a stopped search continues.")
    # fmt: on


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Exit status 0; 1 or 2 with one line for a mistake; 130 after Ctrl-C."""
    end_at_sigterm()
    return run_main(lambda: run(arguments), "refine_policy")


def run(arguments: Optional[Sequence[str]] = None) -> None:
    """Searches as the arguments say; prints a line and writes the policy after each step."""
    given = parsed(RefineOptions, "python -m training.refine_policy", __doc__, arguments)
    actor = Actor.load(given.policy, space_of(given.robot))
    if Path(given.out).resolve() == Path(given.policy).resolve():
        raise ApplrError("--out %s: this is the policy to begin with; give another file" % given.out)
    worlds = Worlds(given.worlds).specs
    needed = WATCHED + given.steps * given.pairs
    if len(worlds) < needed:
        raise ApplrError(
            "--worlds %s: these are %d, and %d steps of %d pairs need %d, %d of which for the directions; give more "
            "worlds, or fewer --steps or --pairs"
            % (given.worlds, len(worlds), given.steps, given.pairs, needed, WATCHED)
        )
    make_folder(Path(given.out).parent)
    folder = make_folder(given.results)
    with closing(Lock(folder, "refine_policy")), continuable():
        refine(given, actor, worlds, folder)


def refine(given: RefineOptions, actor: Actor, worlds: Sequence[str], folder: Path) -> None:
    """Finds the directions, searches, and writes the policy after each step."""
    options: Dict[str, Any] = {
        "policy": given.policy,
        "simulator": given.simulator,
        "period": given.period or actor.period,
        "time_limit": given.limit,
        "monitor": given.monitor,
        "robot": given.robot.name if given.robot is JACKAL else given.robot.folder,
    }
    weights, size = weights_of(actor), len(actor.space)
    make = partial(_trial, given)
    path = str(folder / "directions.safetensors")
    directions = _directions(path, options, actor, [make(world, "") for world in worlds[:WATCHED]], given.components)
    start = sha256(read_bytes(given.policy))
    setting = [checksum(weights), checksum({"mean": directions.mean, "basis": directions.basis})]
    setting += [options[name] for name in DRIVEN]
    runner = RunnerSpec(SHIFTED_RUNNER, dict(options, directions=path))
    with (
        closing(TrialTable(folder / TABLE, setting)) as table,
        closing(RememberedTrials(runner, given.workers, table=table)) as trials,
    ):
        groups = np.tile(np.arange(1 + given.components), size)
        for step in search(trials, make, worlds[WATCHED:], groups, given):
            coefficients = step.centre.reshape(size, -1)
            about = {name: getattr(given, name) for name in SEARCHED}
            about.update(worlds=without_folders(given.worlds), start=start)
            about.update(step=step.number, coefficients=coefficients.tolist())
            metadata = dict(stated(actor), period_s=options["period"])
            metadata["training"] = dict(metadata.get("training") or {}, refined=about)
            save(given.out, directions.shifted(weights, coefficients), metadata, actor.space, actor.layout)
            print(line(step, given.steps), flush=True)
    print("%s: written" % given.out)


def _trial(given: RefineOptions, world: str, coefficients: str) -> Trial:
    seed = seed_of(CHOOSING + given.seed, world, 0)
    return Trial(world, "shifted", 0, seed, world, coefficients, given.planner)


def _directions(
    path: str, options: Dict[str, Any], actor: Actor, trials: Sequence[Trial], components: int
) -> Directions:
    """The directions in the file, or, where it holds none of this search, those that the trials show."""
    weights = weights_of(actor)
    driven = [[trial.world_spec, trial.seed, trial.planner] for trial in trials]
    origin = {"policy": checksum(weights), "components": components, "trials": driven}
    origin.update((name, options[name]) for name in DRIVEN)
    known = known_directions(path, origin)
    if known is not None:
        return known
    print("driving %d worlds for the directions" % len(trials), flush=True)
    found = Directions.found(
        weights, _watched(options, trials), Mirror.of(actor.layout.beams, 1 + len(actor.space)), components
    )
    write_directions(path, found, origin)
    return found


def _watched(options: Dict[str, Any], trials: Sequence[Trial]) -> np.ndarray:
    """The observations (m, n) of the policy's decisions in trials, driven in this process."""
    runner, seen = ShiftedRunner(**options), []
    for trial in trials:
        runner.run(trial)
        seen += runner.observations
    return np.array(seen)


def line(step: Step, steps: int) -> str:
    """How a step went, and what is expected of the policy that was written after it."""
    return (
        "step %d of %d: shifted policies score %.2f s (%d of %d there, %d with a contact); the new one is expected to "
        "take %.2f s less than the given one (largest slope %.1f standard errors, curvature %.1f s, shift %.2f), %d s"
        % (
            step.number,
            steps,
            step.score,
            sum(result.success for result in step.results),
            len(step.results),
            sum(result.collided for result in step.results),
            step.fit.gain(step.centre),
            float(np.max(np.abs(step.fit.slopes / step.fit.errors))),
            step.fit.curvature,
            float(np.linalg.norm(step.centre)),
            step.seconds,
        )
    )


if __name__ == "__main__":
    sys.exit(main())
