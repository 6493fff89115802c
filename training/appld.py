"""APPLD, the paper's second baseline: from recorded demonstrations to a file that can drive.

Started as `rosrun applr_ros1 appld.py` or `python -m training.appld`. Changepoints cut the demonstrations into
segments, similar segments form contexts, CMA-ES finds the parameters of each context, and a small network learns to
recognise the context from the scan. evaluate.py (appld:FILE) and method:=appld use it. docs/howto/appld.md describes
the method.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any, Dict, List, Sequence

import numpy as np

from applr_ros1.common.arguments import without_remappings
from applr_ros1.common.errors import ApplrError, run_main
from applr_ros1.common.files import write_bytes, write_json
from applr_ros1.policy import appld as runtime
from applr_ros1.policy.observation import layout_of
from applr_ros1.policy.parameter_space import space_of
from training.bags.reader import BagOptions, find
from training.baselines.appld import classifier as appld_classifier
from training.baselines.appld import fit as appld_fit
from training.baselines.appld import segmentation as contexts
from training.baselines.appld.card import card
from training.baselines.appld.demonstration import Demonstration, read
from training.common.command_line import Seed, parsed
from training.common.folders import make_folder
from training.common.options import argument, option


class AppldOptions(BagOptions):
    """What to learn from, and how."""

    # fmt: off
    bags: List[str] = argument(
        "Recorded demonstrations: bags of ROS 1 or ROS 2 with scans, odometry and, if possible, commands.")
    out: str = option(...,
        "File to write (.safetensors). The log and a card that describes the file are written beside it.")
    contexts: int = option(4,
        "Largest number of contexts. 0 makes each segment a context, as in the APPLD paper.", ge=0, le=10**6)
    penalty: float = option(3.0, "Cost of a changepoint; a larger one gives fewer segments.", ge=0, le=1e6)
    evaluations: int = option(150,
        "Number of parameter sets that the search of each context tries.", ge=1, le=10**9)
    longest: int = option(100,
        "Largest number of instants (50 ms each) of a segment that the search uses.", ge=1, le=10**9)
    steps: int = option(500, "Number of gradient steps of the classifier's training.", ge=1, le=10**9)
    seed: Seed
    verbose: bool = option(False, "Print a line for each generation of the search.")
    # fmt: on


def learn(
    demonstrations: List[Demonstration], options: AppldOptions, arguments: Sequence[str], say=print
) -> Dict[str, Any]:
    """Writes the file options.out, its log beside it (OUT_log.json) and a card (OUT.md); returns the log.

    Args:
        demonstrations: to learn from.
        options: how.
        arguments: the command line, for the log.
        say: takes a line of progress.
    """
    began = time.monotonic()
    found = contexts.find(demonstrations, options.contexts, options.penalty)
    if len(found.names) > runtime.MAX_CONTEXTS:
        raise ApplrError(
            "--contexts %d: makes %d contexts, a file holds at most %d; give --contexts 1 to %d or a larger --penalty"
            % (options.contexts, len(found.names), runtime.MAX_CONTEXTS, runtime.MAX_CONTEXTS)
        )
    for s in found.segments:
        d = demonstrations[s.demonstration]
        say("%s %5.1f to %5.1f s: context %s" % (d.name, d.time[s.first], d.time[s.last - 1], found.names[s.context]))
    fits = _fits(demonstrations, found, options, say)
    labels = [np.full(s.last - s.first, s.context) for s in found.segments]
    scans = [demonstrations[s.demonstration].seen[s.first : s.last] for s in found.segments]
    space, layout = space_of(options.robot), layout_of(options.robot)
    weights, classifier = appld_classifier.train(
        appld_classifier.inputs(np.concatenate(scans), layout),
        np.concatenate(labels),
        len(found.names),
        options.seed,
        options.steps,
        layout,
    )
    say("classifier: %s of the instants right, %s of those held out" % (classifier["accuracy"], classifier["held_out"]))
    log = _log(demonstrations, found, fits, classifier, options, arguments, time.monotonic() - began)
    sets = {name: f.theta for name, f in zip(found.names, fits)}
    make_folder(Path(options.out).parent)
    short = {key: log[key] for key in ("command", "demonstrations", "classifier")}
    runtime.save(options.out, sets, weights, {"training": json.dumps(short)}, space, layout)
    stem = str(Path(options.out).with_suffix(""))
    write_json(stem + "_log.json", log)
    write_bytes(stem + ".md", card(log).encode())
    return log


def _fits(demonstrations, found, options, say) -> List[appld_fit.Fit]:
    copies: List[List[appld_fit.Stretch]] = [[] for _ in found.names]
    for index, d in enumerate(demonstrations):
        spans = [s for s in found.segments if s.demonstration == index]
        for s, stretch in zip(spans, appld_fit.stretches(d, spans, options.longest)):
            copies[s.context].append(stretch)
    fits = []
    for k, (name, own) in enumerate(zip(found.names, copies)):

        def tell(now, name=name):
            if options.verbose:
                say("  %s: %d replays, loss %.4f" % (name, now.evaluations, now.loss))

        fits.append(appld_fit.fit(own, options.evaluations, options.seed + k, tell))
        last = fits[-1]
        say(
            "context %s: loss %.4f (theta_0: %.4f), rms %.2f m/s %.2f rad/s, %d replays of %d instants: %s"
            % (
                name,
                last.loss,
                last.loss_theta0,
                *last.error,
                last.evaluations,
                last.instants,
                json.dumps(_short(space_of(options.robot), last.theta)),
            )
        )
    return fits


def _short(space, theta) -> Dict[str, float]:
    return {name: round(value, 3) for name, value in space.as_dict(theta).items()}


def _log(demonstrations, found, fits, classifier, options, arguments, seconds) -> Dict[str, Any]:
    return {
        "command": "python -m training.appld " + " ".join(map(_plain, arguments)),
        "demonstrations": [dict(d.source, bag=d.name, seconds=round(float(d.time[-1]), 2)) for d in demonstrations],
        "segments": [
            {
                "demonstration": s.demonstration,
                "from_s": round(float(demonstrations[s.demonstration].time[s.first]), 2),
                "instants": s.last - s.first,
                "context": found.names[s.context],
            }
            for s in found.segments
        ],
        "contexts": [
            {
                "name": name,
                "features": dict(zip(contexts.FEATURES, mean.round(3).tolist())),
                "parameters": space_of(options.robot).as_dict(f.theta),
                "loss": round(f.loss, 5),
                "loss_theta0": round(f.loss_theta0, 5),
                "rms_v_w": f.error,
                "rms_v_w_theta0": f.error_theta0,
                "replays": f.evaluations,
                "instants": f.instants,
                "search": f.log,
            }
            for name, mean, f in zip(found.names, found.means, fits)
        ],
        "beams": layout_of(options.robot).beams,
        "classifier": classifier,
        "turn_weight": appld_fit.TURN_WEIGHT,
        "pull": appld_fit.PULL,
        "seconds": round(seconds, 1),
    }


def _plain(word: str) -> str:
    """A path as it goes into the card: without this machine's folders."""
    return Path(word).name if word.startswith(("/", "~")) else word


def main(arguments=None) -> int:
    """Exit status 0; 1 with one line when there is no file."""
    return run_main(lambda: run(without_remappings(arguments)), "appld.py")


def run(arguments: List[str]) -> None:
    """Learns from the bags that the arguments name and writes the file, its log and its card."""
    options = parsed(AppldOptions, "appld.py", __doc__, arguments)
    if not options.out.endswith(".safetensors"):
        raise ApplrError("--out %s: give a name that ends in .safetensors" % options.out)
    try:
        demonstrations = [read(bag, options.topics(), options.robot) for bag in find(options.bags)]
        log = learn(demonstrations, options, arguments)
    except KeyboardInterrupt:
        raise KeyboardInterrupt("stopped; nothing was written") from None
    print("%s: %d contexts in %.0f s" % (options.out, len(log["contexts"]), log["seconds"]))


if __name__ == "__main__":
    sys.exit(main())
