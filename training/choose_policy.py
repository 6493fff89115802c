"""Drives several policies and their mean in validation worlds, and writes the best as one policy file.

Started as `python -m training.choose_policy A.safetensors B.safetensors ... --out FILE.safetensors`, for instance with
the policies of a recipe's runs with several seeds. In the mean the policies stand side by side, and their outputs
before tanh are averaged: what is chance in each of them is less in it. A policy that is a mean itself counts as many
times as it has networks. A choice that was stopped continues with the same command.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any, Dict, List, Optional, Sequence

from applr_ros1.common.errors import ApplrError, run_main
from applr_ros1.common.files import StorageError, read_bytes, sha256
from applr_ros1.policy.actor import Actor, save
from applr_ros1.robots import Robot
from training.command_line import (
    Parser,
    add_robot,
    add_simulator,
    add_trials,
    add_workers,
    add_worlds,
    continuable,
    end_at_sigterm,
)
from training.evaluation.run import EvaluationOptions, evaluate
from training.evaluation.score import summary_of_rows
from training.evaluation.store import TRIALS, read_rows
from training.evaluation.trials import COLUMNS
from training.policy_file import stated, weights_of
from training.provenance import without_folders
from training.storage import make_folder
from training.td3.averaging import side_by_side

MEAN = "mean"


class ChoiceError(ApplrError):
    """One line: why the policies cannot be compared or averaged."""


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Exit status 0; 1 or 2 with one line for a mistake; 130 after Ctrl-C."""
    end_at_sigterm()
    return run_main(lambda: run(arguments), "choose_policy")


def run(arguments: Optional[Sequence[str]] = None) -> None:
    """Drives what is missing, prints a row for each policy, and writes the one with the lowest score."""
    p = Parser("python -m training.choose_policy", description=__doc__ or "")
    p.add_argument("policies", nargs="+", help="Policy files of one robot, as train.py writes them.")
    p.add_argument("--out", required=True, help="File to write the best policy to, such as applr.safetensors.")
    add_worlds(p, "generated:validation", "compare the policies in")
    add_robot(p)
    add_simulator(p, "pybullet")
    add_trials(p, 3, "of each policy in each world", most=10_000)
    add_workers(p, EvaluationOptions.workers)
    p.add_argument(
        "--results",
        default="results/choice",
        help="Folder for the trials and for the mean policy. Default: %(default)s.",
    )
    given = p.parse_args(arguments)
    folder = make_folder(given.results)
    candidates = {"policy%d" % i: path for i, path in enumerate(given.policies, 1)}
    if len(candidates) > 1:
        candidates[MEAN] = str(folder / (MEAN + ".safetensors"))
        write_mean(candidates[MEAN], given.policies, given.robot)
    options = EvaluationOptions(
        worlds=given.worlds,
        methods=",".join("%s=%s" % candidate for candidate in candidates.items()),
        trials=given.trials,
        simulator=given.simulator,
        workers=given.workers,
        out=str(folder),
        traces=0,
        robot=given.robot,
    )
    try:
        with continuable():
            evaluate(options)
    except StorageError as error:  # the folder is --results here, and --out the file
        raise ChoiceError(str(error).replace("--out", "--results")) from None
    rows = read_rows(folder / TRIALS, COLUMNS)
    setting = ", ".join((without_folders(given.worlds), given.simulator, options.weights[0], options.planner))
    results = {
        name: dict(summary_of_rows([row for row in rows if row["method"] == name]), setting=setting)
        for name in candidates
    }
    best = min(results, key=lambda name: results[name]["score"])
    actor = Actor.load(candidates[best], space=None)
    save(given.out, weights_of(actor), dict(stated(actor), result=results[best]), actor.space, actor.layout)
    print(table(candidates, results), end="")
    print("%s: %s" % (given.out, best))


def write_mean(path: str, policies: Sequence[str], robot: Robot) -> None:
    """Writes the mean of policy files, unless it is there; its "training" adds their transitions up and names them.

    Raises:
        ChoiceError: for policies whose robots, observations, periods, distance weights or numbers of layers differ.
    """
    actors = [Actor.load(policy, space=None) for policy in policies]
    first = actors[0]
    for policy, actor in zip(policies, actors):
        for what, its, ours in (
            ("robot", actor.space.robot, robot.name),
            ("parameter space", actor.space.to_json(), first.space.to_json()),
            ("observation", actor.layout, first.layout),
            ("decision period", actor.period, first.period),
            ("kind of distance weights", actor.weights, first.weights),
            ("number of layers", len(actor.layers), len(first.layers)),
        ):
            if its != ours:
                raise ChoiceError(
                    "%s: its %s is %.60s, not %.60s as %s; give policies that are alike"
                    % (policy, what, its, ours, "--robot" if what == "robot" else policies[0])
                )
    training = [actor.metadata.get("training") or {} for actor in actors]
    parts = [
        {
            "sha256": sha256(read_bytes(policy)),
            "seed": t.get("options", {}).get("seed"),
            "transitions": t.get("transitions"),
            "updates": t.get("updates"),
        }
        for policy, t in zip(policies, training)
    ]
    if Path(path).exists() and Actor.load(path, space=None).metadata["training"].get("mean_of") == parts:
        return  # the order of the metadata, and so the checksum by which trials know a policy, would be another
    together = {
        **training[0],
        **{key: sum(t.get(key, 0) for t in training) for key in ("steps", "transitions", "updates")},
        "mean_of": parts,
    }
    metadata = dict(stated(first), training=together)
    save(path, side_by_side([weights_of(actor) for actor in actors]), metadata, first.space, first.layout)


def table(candidates: Dict[str, str], results: Dict[str, Dict[str, Any]]) -> str:
    """A row for each policy."""
    lines: List[str] = [
        "| policy | trials | score [s] | time [s] | success | with a contact |",
        "|---|%s" % ("---:|" * 5),
    ]
    for name, path in candidates.items():
        r = results[name]
        lines.append(
            "| %s | %d | %.2f | %s | %.1f %% | %.1f %% |"
            % (
                *("mean of them" if name == MEAN else Path(path), r["trials"], r["score"]),
                *("-" if r["time_s"] is None else "%.2f" % r["time_s"], 100 * r["success"], 100 * r["collided"]),
            )
        )
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
