"""Compares variants of the learning: the same wall time and seeds for each, judged in worlds that none trained in.

Started as `python -m training.compare_variants FILE.yaml --out DIR`. The YAML file holds what is common and the
variants, each a few options of train.py (training/variants/learning.yaml is one); the robot is among these options,
and trials are driven with it. A comparison that was stopped continues with the same command. docs/training.md describes
the table.
"""

from __future__ import annotations

import csv
import io
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Dict, List, Optional, Sequence, Tuple, get_type_hints

import numpy as np
import yaml

from applr_ros1.common.errors import ApplrError, run_main
from applr_ros1.common.files import read_bytes, read_json, sha256, write_bytes
from applr_ros1.robots import load
from training.afterwards import NOTHING
from training.command_line import Parser, add_simulator, add_trials, add_worlds, continuable, end_at_sigterm, whole
from training.evaluation.run import EvaluationOptions, evaluate
from training.evaluation.score import summary_of_rows
from training.evaluation.store import MEASURES_FILE, TRIALS, flag, read_rows
from training.evaluation.trials import COLUMNS, MEASURES
from training.gorila import config as options
from training.gorila.learner import Learner
from training.report.variants import draw_variants
from training.storage import make_folder

NAME = re.compile(r"^[A-Za-z0-9][\w.]*$", re.ASCII)  # of a variant
VARIANTS = Path(__file__).resolve().parent / "variants"  # comparisons that come with the package


class VariantsError(ApplrError):
    """One line: what of the YAML file or of a run is wrong."""


@dataclass(frozen=True)
class Comparison:
    """The content of a YAML file.

    Attributes:
        variants: name -> the options in which it differs.
        minutes: wall time of each run.
        seeds: of the runs; each variant has one run with each.
        recipe: that all begin with; "" for train.py's defaults.
        options: common to all, over those of the recipe.
    """

    variants: Dict[str, dict]
    minutes: float
    seeds: list = field(default_factory=lambda: [0, 1, 2])
    recipe: str = ""
    options: dict = field(default_factory=dict)

    def runs(self) -> List[Tuple[str, int]]:
        """(variant, seed) of all runs: first each variant with the first seed, so that what is there compares."""
        return [(name, seed) for seed in self.seeds for name in self.variants]

    def of(self, name: str, seed: int) -> Dict[str, Any]:
        """The options of a run, checked, those that follow from others included. Raises ConfigError, VariantsError.

        What a recipe does after the training is left out: it would take time beside `minutes`.
        """
        given = {**self.options, **self.variants[name]}
        for option in NOTHING:
            if option in given:
                raise VariantsError(
                    "variant %s: %s takes time beside minutes, which must be equal; leave it out" % (name, option)
                )
        given = {**options.recipe(self.recipe), **given, **NOTHING, "seed": seed, "minutes": float(self.minutes)}
        config = options.TrainConfig(**options.from_dict(given, "variant %s" % name)).resolved()
        return {key: value for key, value in asdict(config).items() if key not in ("out", "resume")}


def read(path: str) -> Comparison:
    """A YAML file. Raises VariantsError or ConfigError with one line."""
    try:
        values = yaml.safe_load(read_bytes(path).decode())
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise VariantsError("%s: not YAML (%s)" % (path, str(error).splitlines()[0])) from None
    hints = get_type_hints(Comparison)
    if not isinstance(values, dict) or not set(values) <= set(hints) or not {"variants", "minutes"} <= set(values):
        raise VariantsError("%s: give variants and minutes, and if need be %s" % (path, ", ".join(sorted(hints))))
    for name, value in values.items():
        kind = getattr(hints[name], "__origin__", hints[name])
        if not isinstance(value, (int, float) if kind is float else kind) or isinstance(value, bool):
            raise VariantsError("%s: %s is %r; give %s" % (path, name, value, options.KINDS[kind]))
    found = Comparison(**values)
    if not found.variants or not found.seeds or found.minutes <= 0:
        raise VariantsError("%s: variants, seeds and minutes must not be empty" % path)
    for name, given in found.variants.items():
        if not isinstance(given, dict) or not NAME.match(str(name)):
            raise VariantsError(
                "%s: variant %r: give a name of letters, digits, . and _, and its options" % (path, name)
            )
    for name, seed in found.runs():
        found.of(name, seed)
    return found


def train(comparison: Comparison, out: Path, parallel: int) -> None:
    """Makes the runs that are missing or not at their end, `parallel` of them at the same time, on cores of their own.

    Raises:
        VariantsError: for a run that failed; its folder's log says why.
    """
    runs = [(comparison.of(name, seed), folder_of(out, name, seed)) for name, seed in comparison.runs()]
    waiting = [(given, folder) for given, folder in runs if not _done(given, folder)]
    free = shares(sorted(os.sched_getaffinity(0)), parallel)
    running: Dict[subprocess.Popen, Tuple[Path, List[int]]] = {}
    try:
        while waiting or running:
            while waiting and free:
                given, folder = waiting.pop(0)
                cores = free.pop()
                running[_start(given, folder, cores)] = folder, cores
                print("%s: %g minutes of training" % (folder, comparison.minutes), flush=True)
            time.sleep(0.2)
            for process in [p for p in running if p.poll() is not None]:
                folder, cores = running.pop(process)
                free.append(cores)
                if process.returncode != 0:
                    raise VariantsError("%s: train.py failed; see %s" % (folder, beside(folder, ".log")))
    finally:
        for process in running:
            process.send_signal(signal.SIGINT)  # which saves the run
        for process in running:
            process.wait()


def shares(cores: Sequence[int], parallel: int) -> List[List[int]]:
    """The cores of each of so many runs at the same time: as many for one as for the other, so that they compare.

    Where there are more runs than cores, all of them share all cores.
    """
    each = len(cores) // parallel
    return [list(cores[i * each : (i + 1) * each]) or list(cores) for i in range(parallel)]


def folder_of(out: Path, name: str, seed: int) -> Path:
    """The folder of a run."""
    return out / ("%s-%d" % (name, seed))


def policy_of(folder: Path) -> Path:
    """The policy of a run that is judged: its best one, or the newest where nothing was evaluated."""
    best = folder / "best.safetensors"
    return best if best.exists() else folder / "actor.safetensors"


def trials_of(folder: Path) -> Path:
    """Where the trials of a run's policy lie: another policy of the run, after longer training, has another folder."""
    return folder / ("validation-" + sha256(read_bytes(policy_of(folder)))[:8])


def beside(folder: Path, end: str) -> Path:
    """The file that lies beside a run's folder and is called like it."""
    return folder.parent / (folder.name + end)


def _start(given: Dict[str, Any], folder: Path, cores: Sequence[int]) -> subprocess.Popen:
    command = [sys.executable, "-m", "training.train", "--out", str(folder)]
    if (folder / "config.json").exists():
        command += ["--resume", "--minutes", str(given["minutes"])]
    else:
        recipe = beside(folder, ".yaml")
        write_bytes(recipe, yaml.safe_dump(given).encode())
        command += ["--recipe", str(recipe)]
    with beside(folder, ".log").open("ab") as log:
        process = subprocess.Popen(command, stdout=log, stderr=log, stdin=subprocess.DEVNULL)
    os.sched_setaffinity(process.pid, cores)  # its actors inherit this
    return process


def _done(given: Dict[str, Any], folder: Path) -> bool:
    """Whether the run is at its end. Raises VariantsError where the folder holds a run with other options."""
    if not (folder / "config.json").exists():
        return False
    stored = {**asdict(options.TrainConfig()), **read_json(folder / "config.json")}  # newer options: their defaults
    for key, value in given.items():
        if key != "minutes" and stored[key] != value:
            raise VariantsError(
                "%s: holds a run with %s %r, not %r; give another --out" % (folder, key, stored[key], value)
            )
    saved = Learner.saved(folder)
    if saved is None:
        return False
    elapsed = saved["extra"].get("elapsed", 0.0)
    return elapsed >= 60.0 * given["minutes"] or Learner.collected_in(saved) >= given["steps"]


def judge(comparison: Comparison, out: Path, worlds: str, simulator: str, trials: int, workers: int) -> None:
    """Drives the best policy of each run, with its robot, in the worlds.

    A policy of this project states what its distance weights count and is sent what means the same, so one kind of
    weights is enough.
    """
    for name, seed in comparison.runs():
        folder = folder_of(out, name, seed)
        evaluate(
            EvaluationOptions(
                worlds=worlds,
                methods="policy=%s" % policy_of(folder),
                trials=trials,
                simulator=simulator,
                workers=workers,
                out=str(trials_of(folder)),
                traces=0,
                robot=load(comparison.of(name, seed)["robot"]),
            )
        )


def table(comparison: Comparison, out: Path) -> List[Dict[str, Any]]:
    """A row for each variant: means over its seeds, and the standard deviation of the score over the seeds."""
    first, rows = None, []
    for name in comparison.variants:
        of_seed = [_figures(folder_of(out, name, seed)) for seed in comparison.seeds]
        scores = np.array([figures["score"] for figures in of_seed])
        first = scores if first is None else first
        row: Dict[str, Any] = {"variant": name, "seeds": len(of_seed)}
        row.update({key: _mean([figures[key] for figures in of_seed]) for key in of_seed[0]})
        row["spread"] = float(scores.std(ddof=1)) if len(scores) > 1 else float("nan")
        row["against_first"] = float((scores - first).mean())
        rows.append(row)
    return rows


def _mean(values: Sequence[float]) -> float:
    known = [value for value in values if not np.isnan(value)]
    return float(np.mean(known)) if known else float("nan")


def _figures(folder: Path) -> Dict[str, float]:
    driven = trials_of(folder)
    trials, measures = read_rows(driven / TRIALS, COLUMNS), read_rows(driven / MEASURES_FILE, MEASURES)
    success = np.array([flag(row["success"]) for row in trials])
    saved, found = Learner.saved(folder) or {}, summary_of_rows(trials)

    def measured(name: str, of=np.mean) -> float:  # of the successes, as the report's table of smoothness
        values = np.array([float(row[name]) for row in measures])
        return float(of(values[success])) if success.any() else float("nan")

    return {
        "score": found["score"],
        "time_s": float("nan") if found["time_s"] is None else found["time_s"],
        "success": found["success"],
        "contact": found["collided"],
        "jerk": measured("mean_jerk"),
        "turn": measured("mean_turn"),
        "switching": measured("switching"),
        "clearance_m": measured("min_clearance_m", np.median),
        "transitions": float(saved.get("transitions", 0)),
        "updates": float(saved.get("updates", 0)),
    }


def markdown(rows: Sequence[Dict[str, Any]]) -> str:
    """The rows as a table."""
    head = (
        "| variant | seeds | score [s] | against the first | time [s] | success | contacts | jerk [m/s³] "
        "| change of parameters | smallest range [m] | transitions | updates |"
    )
    lines = [head, "|---|%s" % ("---:|" * 11)]
    for r in rows:
        spread = "" if np.isnan(r["spread"]) else " ± %.2f" % r["spread"]
        lines.append(
            "| %s | %d | %.2f%s | %+.2f | %.2f | %.1f %% | %.1f %% | %.1f | %.2f | %.2f | %.0f | %.0f |"
            % (
                *(r["variant"], r["seeds"], r["score"], spread, r["against_first"], r["time_s"]),
                *(100 * r["success"], 100 * r["contact"], r["jerk"], r["switching"], r["clearance_m"]),
                *(r["transitions"], r["updates"]),
            )
        )
    return "\n".join(lines) + "\n"


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Exit status 0; 1 or 2 with one line for a mistake; 130 after Ctrl-C."""
    end_at_sigterm()
    return run_main(lambda: run(arguments), "compare_variants")


def run(arguments: Optional[Sequence[str]] = None) -> None:
    """Trains and judges what is missing, and writes the table and the picture."""
    p = Parser("python -m training.compare_variants", description=__doc__ or "")
    p.add_argument("file", help="YAML file with the variants.")
    p.add_argument(
        "--out",
        required=True,
        help="Folder for the runs and the table. Comparisons that have a run in common can share a folder.",
    )
    p.add_argument(
        "--parallel",
        type=whole(1, 1000),
        default=1,
        help="Number of runs that train at the same time, each on its equal share of the cores, and of trials that are "
        "driven at the same time afterwards. Default: %(default)s.",
    )
    add_worlds(p, "generated:validation", "judge in")
    add_simulator(p, "kinematic")
    add_trials(p, 4, "in each world", most=10_000)
    given = p.parse_args(arguments)
    comparison, out = read(given.file), make_folder(given.out)
    with continuable():
        train(comparison, out, given.parallel)
        judge(comparison, out, given.worlds, given.simulator, given.trials, given.parallel)
    rows = table(comparison, out)
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]))
    writer.writeheader()
    writer.writerows(rows)
    name = Path(given.file).stem  # several comparisons may share a folder, and runs
    write_bytes(out / (name + ".csv"), text.getvalue().encode())
    write_bytes(out / (name + ".md"), markdown(rows).encode())
    draw_variants(out / (name + ".png"), rows)
    print(markdown(rows), end="")


if __name__ == "__main__":
    sys.exit(main())
