"""Trainings with several seeds, whose best policy is kept: `train.py --seeds 3`.

The result of a training depends on its seed. Runs with several seeds share the time or a dataset, and their best
policies drive the same fresh courses. The policy with the lowest mean score is compared with the robot's default
parameters on other fresh courses, so that the selection does not bias the verdict.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any, Callable, List, Mapping, Sequence

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import write_json
from applr_ros1.policy import methods
from training.common.folders import make_folder
from training.evaluate.evaluation import EvaluationOptions, evaluate
from training.evaluate.trial import BASELINE
from training.evaluate.verdict import POLICY, SET, mean_scores, paired_trials, verdict
from training.train.learner.config import TrainConfig

if TYPE_CHECKING:
    import pandas as pd

CHOICE, VERDICT = (
    "fresh:21000-21049",
    "fresh:22000-22049",
)  # courses of the selection and of the verdict


def train(config: TrainConfig, make_run: Callable[[TrainConfig], Any]) -> int:
    """Train config.seeds policies into folders of config.out, and keep the best as best.safetensors there.

    The runs divide config.minutes equally. With --resume, stopped trainings continue.

    Args:
        config: Options of the runs.
        make_run: Function that makes the TrainingRun of one seed.

    Returns:
        The exit status: 0 done, 130 stopped by a signal and saved.

    Raises:
        ApplrError: The folder already holds a run, or a run fails.
    """
    out = make_folder(config.out)
    if (out / "config.json").exists() and not config.resume:
        raise ApplrError(
            f"{out} already holds a run: continue it with --resume, or give another --out"
        )
    write_json(out / "config.json", config.model_dump(exclude={"resume"}))
    policies = []
    for seed in range(config.seed, config.seed + config.seeds):
        folder = out / f"seed_{seed}"
        one = {"seed": seed, "out": str(folder), "minutes": config.minutes / config.seeds}
        run = make_run(
            config.model_copy(update={**one, "resume": (folder / "config.json").exists()})
        )
        if status := run.run():
            return int(status)
        policies.append(
            folder / ("best.safetensors" if run.evaluation.best else "actor.safetensors")
        )
    print("\n".join(choose(config, out, policies)))
    return 0


def choose(config: TrainConfig, out: Path, policies: Sequence[Path]) -> List[str]:
    """Keep the best policy as best.safetensors in `out`, and return lines that describe the choice."""
    by_run = {path.parent.name: path for path in policies}
    means = mean_scores(_driven(config, out / "choice", CHOICE, [], by_run)).mean()
    best = out / "best.safetensors"
    shutil.copyfile(by_run[str(means.idxmin())], best)
    others = [BASELINE] + [SET] * Path(methods.shipped(methods.SET, config.robot)).exists()
    method, lines = verdict(_driven(config, out / "verdict", VERDICT, others, {POLICY: best}))
    chosen = ", ".join(f"{name} {mean:.1f} s" for name, mean in means.items())
    return [
        f"mean scores of the policies: {chosen}",
        *lines,
        f"drive with: {method}; best policy: {best}",
    ]


def _driven(
    config: TrainConfig, out: Path, worlds: str, others: Sequence[str], policies: Mapping[str, Path]
) -> pd.DataFrame:
    """Evaluate methods and policies {name: file} with the run's evaluation settings, and return paired_trials()."""
    shutil.rmtree(out, ignore_errors=True)  # results of earlier policies, before a --resume
    out.mkdir(parents=True)
    files = {name: out / f"{name}.safetensors" for name in policies}
    for name, file in files.items():
        shutil.copyfile(policies[name], file)
    chosen = ",".join(map(str, [*others, *files.values()]))
    how = {**config.judged, "seed": config.seed, "workers": config.actors}
    evaluation = EvaluationOptions(**how, worlds=worlds, methods=chosen, trials=1, out=str(out))
    return paired_trials(evaluate(evaluation), [*others, *files])
