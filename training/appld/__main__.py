"""Learns a policy of APPLD, the paper's second baseline, from recorded demonstrations.

Run it as `rosrun applr_ros1 appld.py` or `python -m training.appld`. Changepoints cut the
demonstrations into segments, similar segments form contexts, CMA-ES finds the parameters of each
context, and a small network learns to recognise the context from the scan. The option --methods of
./applr evaluate and method:= accept the file that the command writes. docs/howto/training.md
describes the method.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any, Dict, List, Optional, Sequence

import numpy as np

from applr_ros1.common.arguments import without_remappings
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.extras import extra
from applr_ros1.common.files import write_json
from applr_ros1.policy import actor
from applr_ros1.policy.observation import layout_of
from applr_ros1.policy.parameter_space import Space, space_of
from applr_ros1.robots import Robot
from training.common.command_line import Seed, run_command
from training.common.folders import make_folder
from training.common.options import argument, option
from training.common.provenance import without_folders

with extra(__name__):
    from training.appld import classifier, segmentation
    from training.appld.demonstration import Demonstration, policy_scans, read_demonstration
    from training.appld.fit import ContextFit, DemonstrationStretch, fit, stretches
    from training.bags.options import BagOptions
    from training.bags.read import bags_in


class AppldOptions(BagOptions):
    """Demonstrations to learn from, and options of the learning."""

    # fmt: off
    bags: List[str] = argument(
        "Recorded demonstrations: ROS 1 or ROS 2 bags with scans, odometry and commands.")
    out: str = option(...,
        "File to write (.safetensors). The log is written beside it.")
    seed: Seed
    # fmt: on


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the command.

    Return 0, or 1 after a one-line error if no file was written.
    """
    words = without_remappings(arguments)
    return run_command(
        AppldOptions, lambda options: run(options, words), "appld.py", __doc__, words
    )


def run(options: AppldOptions, words: List[str]) -> None:
    """Learn from bags, and write the file and its log (OUT_log.json).

    Args:
        options: The options.
        words: The command line, for the log.
    """
    policy_file = Path(options.out)
    if policy_file.suffix != ".safetensors":
        raise ApplrError(f"--out {policy_file}: give a name that ends in .safetensors")
    start_time = time.monotonic()
    robot = options.robot
    topics = options.topics()
    demonstrations = []
    scans_of = []
    for bag_path in bags_in(options.bags):
        demonstration = read_demonstration(bag_path, topics, robot)
        demonstrations.append(demonstration)
        scans_of.append(policy_scans(demonstration, robot))
    split = segmentation.find(demonstrations, robot)

    # Parameters of each context
    space = space_of(robot)
    parameter_sets: Dict[str, np.ndarray] = {}
    contexts: List[Dict[str, Any]] = []
    by_context = _stretches_by_context(demonstrations, split, robot)
    for context_name, mean_features, context_stretches in zip(split.names, split.means, by_context):
        best_fit = fit(context_stretches, options.seed + len(contexts))
        # The policy's file holds only the parameters that the paper's encoding sets.
        parameter_sets[context_name] = space.chosen_of(best_fit.theta)
        contexts.append(_described(context_name, mean_features, best_fit, space))

    # Classifier of the context
    layout = layout_of(robot)
    scans: List[np.ndarray] = []
    labels: List[int] = []
    for segment in split.segments:
        scans.extend(scans_of[segment.demonstration][segment.first : segment.last])
        labels.extend([segment.context] * (segment.last - segment.first))
    weights, quality = classifier.train(
        classifier.inputs(np.array(scans), layout),
        np.array(labels),
        len(parameter_sets),
        options.seed,
        layout,
    )
    print(f"classifier: accuracy {quality['accuracy']}, on held-out instants {quality['held_out']}")

    # Files, without folders of this machine, because they are passed on
    provenance = {
        "command": "python -m training.appld " + " ".join(map(without_folders, words)),
        "demonstrations": list(map(_source, demonstrations)),
        "classifier": quality,
    }
    make_folder(policy_file.parent)
    metadata = {"training": provenance}
    actor.save_contexts(policy_file, parameter_sets, weights, metadata, space, layout)
    segments = []
    for segment in split.segments:
        segments.append({**segment._asdict(), "context": split.names[segment.context]})
    seconds = round(time.monotonic() - start_time, 1)
    log = {**provenance, "segments": segments, "contexts": contexts, "seconds": seconds}
    write_json(policy_file.with_name(f"{policy_file.stem}_log.json"), log)
    print(f"{policy_file}: {len(contexts)} contexts in {seconds:.0f} s")


def _stretches_by_context(
    demonstrations: Sequence[Demonstration], split: segmentation.Contexts, robot: Robot
) -> List[List[DemonstrationStretch]]:
    """Return the stretches of each context, and print the segments.

    A stretch is what the fit replays of a segment.
    """
    by_context: List[List[DemonstrationStretch]] = [[] for _ in split.names]
    for demonstration_index, demonstration in enumerate(demonstrations):
        times = demonstration.commands.time
        segments = []
        for segment in split.segments:
            if segment.demonstration == demonstration_index:
                segments.append(segment)
        for segment, stretch in zip(segments, stretches(demonstration, robot, segments)):
            by_context[segment.context].append(stretch)
            time_span = f"{times[segment.first]:5.1f} to {times[segment.last - 1]:5.1f} s"
            print(f"{demonstration.name} {time_span}: context {split.names[segment.context]}")
    return by_context


def _described(name: str, mean: np.ndarray, best: ContextFit, space: Space) -> Dict[str, Any]:
    """Return the log's entry of a context, and print its fit.

    Args:
        name: Name of the context.
        mean: Means of FEATURES (5,) in the context.
        best: Fit of the context.
        space: Parameter space of the robot.
    """
    print(f"context {name}: loss {best.loss:.4f} (default parameters: {best.loss_theta0:.4f})")
    log_entry = {
        "name": name,
        "features": dict(zip(segmentation.FEATURES, mean.round(3).tolist())),
        "parameters": space.as_dict(best.theta),
        **vars(best),
    }
    del log_entry["theta"]  # The same values as the parameters
    return log_entry


def _source(demonstration: Demonstration) -> Dict[str, Any]:
    """Return where a demonstration comes from: its bag, duration [s], and the bag's metadata."""
    seconds = round(float(demonstration.commands.time[-1]), 2)
    return {**demonstration.source, "bag": demonstration.name, "seconds": seconds}


if __name__ == "__main__":
    sys.exit(main())
