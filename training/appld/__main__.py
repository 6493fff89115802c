"""Learns a policy of APPLD, the paper's second baseline, from recorded demonstrations.

Run it as `rosrun applr_ros1 appld.py` or `python -m training.appld`. Changepoints cut the demonstrations into
segments, similar segments form contexts, CMA-ES finds the parameters of each context, and a small network learns to
recognise the context from the scan. evaluate.py --methods and method:= accept the file that the command writes.
docs/howto/training.md describes the method.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any, Dict, List, Optional, Sequence

import numpy as np

from applr_ros1.common.arguments import without_remappings
from applr_ros1.common.errors import ApplrError, run_main
from applr_ros1.common.extras import extra
from applr_ros1.common.files import write_json
from applr_ros1.drives.drive import Drive
from applr_ros1.policy import actor
from applr_ros1.policy.observation import layout_of
from applr_ros1.policy.parameter_space import space_of
from training.common.command_line import Seed, parsed
from training.common.folders import make_folder
from training.common.options import argument, option
from training.common.provenance import without_folders

with extra(__name__):
    from training.appld import classifier, segmentation
    from training.appld.demonstration import policy_scans, read_demonstration
    from training.appld.fit import Stretch, fit, stretches
    from training.bags.read import bags_in
    from training.bags.topics import BagOptions


class AppldOptions(BagOptions):
    """Demonstrations to learn from, and options of the learning."""

    # fmt: off
    bags: List[str] = argument(
        "Recorded demonstrations: ROS 1 or ROS 2 bags with scans, odometry and commands.")
    out: str = option(...,
        "File to write (.safetensors). The log is written beside it.")
    contexts: int = option(4,
        "Largest number of contexts. 0 makes each segment a context, as in the APPLD paper.", ge=0, le=10**6)
    penalty: float = option(3.0, "Cost of a changepoint; a higher cost gives fewer segments.", ge=0, le=1e6)
    evaluations: int = option(150,
        "Number of parameter sets that the search of each context tries.", ge=1, le=10**9)
    seed: Seed
    # fmt: on


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the command. Return 0, or 1 after a one-line error if no file was written."""
    return run_main(lambda: run(without_remappings(arguments)), "appld.py")


def _seconds(demonstration: Drive) -> float:
    """Return the duration of a demonstration, rounded [s]."""
    assert demonstration.commands is not None
    return round(float(demonstration.commands.time[-1]), 2)


def run(arguments: List[str]) -> None:
    """Learn from the bags named in the arguments, and write the file and its log (OUT_log.json)."""
    options = parsed(AppldOptions, "appld.py", __doc__, arguments)
    if not options.out.endswith(".safetensors"):
        raise ApplrError(f"--out {options.out}: give a name that ends in .safetensors")
    began, topics, robot = time.monotonic(), options.topics(), options.robot
    demonstrations = [read_demonstration(bag, topics, robot) for bag in bags_in(options.bags)]
    split = segmentation.find(demonstrations, robot, options.contexts, options.penalty)
    by_context: List[List[Stretch]] = [[] for _ in split.names]
    for index, d in enumerate(demonstrations):
        spans = [s for s in split.segments if s.demonstration == index]
        assert d.commands is not None
        times = d.commands.time
        for s, stretch in zip(spans, stretches(d, robot, spans)):
            by_context[s.context].append(stretch)
            print(
                f"{d.name} {times[s.first]:5.1f} to {times[s.last - 1]:5.1f} s: context {split.names[s.context]}"
            )

    space, layout = space_of(robot), layout_of(robot)
    sets: Dict[str, np.ndarray] = {}
    contexts: List[Dict[str, Any]] = []
    for name, mean, part in zip(split.names, split.means, by_context):
        best = fit(part, options.evaluations, options.seed + len(contexts))
        sets[name], parameters = space.pick(best.theta), space.as_dict(best.theta)
        print(
            f"context {name}: loss {best.loss:.4f} (default parameters: {best.loss_theta0:.4f}), rms error of commands "
            f"{best.rms_v_w[0]:.2f} m/s, {best.rms_v_w[1]:.2f} rad/s, {best.replays} sets tried on {best.instants} "
            f"instants; best parameters: { {name: round(value, 3) for name, value in parameters.items()} }"
        )
        features = dict(zip(segmentation.FEATURES, mean.round(3).tolist()))
        row = {"name": name, "features": features, "parameters": parameters, **vars(best)}
        del row["theta"]
        contexts.append(row)

    seen = [policy_scans(demonstration, robot) for demonstration in demonstrations]
    scans = np.concatenate([seen[s.demonstration][s.first : s.last] for s in split.segments])
    labels = np.concatenate([np.full(s.last - s.first, s.context) for s in split.segments])
    weights, quality = classifier.train(
        classifier.inputs(scans, layout), labels, len(sets), options.seed, layout
    )
    print(f"classifier: accuracy {quality['accuracy']}, on held-out instants {quality['held_out']}")
    about = {
        "command": "python -m training.appld " + " ".join(map(without_folders, arguments)),
        "demonstrations": [dict(d.source, bag=d.name, seconds=_seconds(d)) for d in demonstrations],
        "classifier": quality,
    }
    make_folder(Path(options.out).parent)
    actor.save_contexts(options.out, sets, weights, {"training": about}, space, layout)
    segments = [dict(s._asdict(), context=split.names[s.context]) for s in split.segments]
    log = {
        **about,
        "segments": segments,
        "contexts": contexts,
        "seconds": round(time.monotonic() - began, 1),
    }
    write_json(f"{options.out[: -len('.safetensors')]}_log.json", log)
    print(f"{options.out}: {len(contexts)} contexts in {log['seconds']:.0f} s")


if __name__ == "__main__":
    sys.exit(main())
