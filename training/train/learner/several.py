"""Trainings with several seeds, whose best policy is kept: `./applr train --seeds 3`.

The result of a training depends on its seed. Runs with several seeds share the time or a dataset,
and their best policies drive the same fresh courses. The policy with the lowest mean score is
compared with the robot's default parameters on other fresh courses, so that the selection does not
bias the verdict.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any, Callable, List, Mapping, Sequence

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import write_json
from applr_ros1.policy import methods
from applr_ros1.robots.geometry import radius
from training.evaluate.evaluation import EvaluationOptions, evaluate
from training.evaluate.runner import check_unseen
from training.evaluate.score import mean_scores
from training.evaluate.trial import BASELINE
from training.evaluate.verdict import POLICY, SET, paired_trials, verdict
from training.train.learner.config import TrainConfig
from training.train.learner.learner import CHECKPOINT
from worlds import listed_specs

if TYPE_CHECKING:
    import pandas as pd

CHOICE = "fresh:21000-21049"  # courses of the selection
VERDICT = "fresh:22000-22049"  # courses of the verdict


def train(config: TrainConfig, make_run: Callable[[TrainConfig], Any]) -> int:
    """Train config.seeds policies into folders of config.out, and keep the best of them.

    It is copied to best.safetensors in config.out. The runs divide config.minutes equally. With
    --resume, stopped trainings continue.

    Args:
        config: Options of the runs.
        make_run: Function that makes the TrainingRun of one seed.

    Returns:
        The exit status: 0 done, 130 stopped by a signal and saved.

    Raises:
        ApplrError: The folder already holds a run, or a run fails.
    """
    out_folder = config.folder()
    if (out_folder / CHECKPOINT).exists():
        remedy = "continue it with --resume --seeds 1"
        if (out_folder.parent / "config.json").exists():
            remedy = f"give --resume --out {out_folder.parent}, which continues all seeds"
        raise ApplrError(f"{out_folder} is the run of one seed: {remedy}")
    check_unseen(
        listed_specs(config.worlds, radius(config.robot)), listed_specs(f"{CHOICE},{VERDICT}")
    )
    policies = []
    for seed in range(config.seed, config.seed + config.seeds):
        run_folder = out_folder / f"seed_{seed}"
        changes = {
            "seed": seed,
            "out": str(run_folder),
            "minutes": config.minutes / config.seeds,
            "resume": (run_folder / "config.json").exists(),
        }
        training_run = make_run(config.model_copy(update=changes))
        # Only now: a start that is refused makes no run that --resume would have to continue.
        write_json(out_folder / "config.json", config.model_dump(exclude={"resume"}))
        status = int(training_run.run())
        if status:
            return status
        policies.append(training_run.policy_file)
    print("\n".join(choose(config, out_folder, policies)))
    return 0


def choose(config: TrainConfig, out: Path, policies: Sequence[Path]) -> List[str]:
    """Keep the best policy as best.safetensors in `out`, and return lines about the choice."""
    # The policy is chosen on other courses than those of the verdict: the best of several is partly
    # the luckiest, and its mean score on the courses of the choice would be too good.
    by_run = {path.parent.name: path for path in policies}
    mean_of_policy = mean_scores(_driven(config, out / "choice", CHOICE, [], by_run)).mean()
    best_file = out / "best.safetensors"
    shutil.copyfile(by_run[str(mean_of_policy.idxmin())], best_file)
    other_methods = [BASELINE]
    if Path(methods.shipped(methods.SET, config.robot)).exists():
        other_methods.append(SET)
    trials = _driven(config, out / "verdict", VERDICT, other_methods, {POLICY: best_file})
    method, lines = verdict(trials)
    chosen = ", ".join(f"{name} {mean:.1f} s" for name, mean in mean_of_policy.items())
    return [
        f"mean scores of the policies: {chosen}",
        *lines,
        f"drive with: {method}; best policy: {best_file}",
    ]


def _driven(
    config: TrainConfig, out: Path, worlds: str, others: Sequence[str], policies: Mapping[str, Path]
) -> pd.DataFrame:
    """Evaluate methods and policies with the run's evaluation settings.

    Args:
        config: Options of the run.
        out: Folder for the trials.
        worlds: Specification of the courses.
        others: Names of methods.
        policies: Files of policies by name.

    Returns:
        paired_trials() of all methods and policies.
    """
    shutil.rmtree(out, ignore_errors=True)  # results of earlier policies, before a --resume
    out.mkdir(parents=True)
    policy_files = {policy_name: out / f"{policy_name}.safetensors" for policy_name in policies}
    for policy_name, policy_file in policy_files.items():
        shutil.copyfile(policies[policy_name], policy_file)
    chosen = ",".join(map(str, [*others, *policy_files.values()]))
    evaluation = EvaluationOptions(
        **config.judged,
        seed=config.seed,
        # The policies are files of this machine, which no other one has.
        workers=min(config.actors, len(os.sched_getaffinity(0))),
        worlds=worlds,
        methods=chosen,
        trials=1,
        out=str(out),
    )
    return paired_trials(evaluate(evaluation), [*others, *policy_files])
