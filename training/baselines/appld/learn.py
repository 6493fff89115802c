"""Learning from demonstrations: contexts, their parameters, the classifier, and the policy file with its log."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any, Dict, List, Sequence

import numpy as np

from applr_ros1.common.extras import extra
from applr_ros1.common.files import write_json
from applr_ros1.policy import actor
from applr_ros1.policy.observation import layout_of
from applr_ros1.policy.parameter_space import space_of
from training.common.command_line import Seed
from training.common.folders import make_folder
from training.common.options import argument, option

with extra(__name__):
    from training.bags.bag import BagOptions
    from training.baselines.appld import classifier as appld_classifier
    from training.baselines.appld import fit as appld_fit
    from training.baselines.appld import segmentation as contexts
    from training.baselines.appld.demonstration import Demonstration


class AppldOptions(BagOptions):
    """Demonstration to learn from, and how."""

    # fmt: off
    bags: List[str] = argument(
        "Recorded demonstrations: bags of ROS 1 or ROS 2 with scans, odometry and commands.")
    out: str = option(...,
        "File to write (.safetensors). The log is written beside it.")
    contexts: int = option(4,
        "Largest number of contexts. 0 makes each segment a context, as in the APPLD paper.", ge=0, le=10**6)
    penalty: float = option(3.0, "Cost of a changepoint; a larger one gives fewer segments.", ge=0, le=1e6)
    evaluations: int = option(150,
        "Number of parameter sets that the search of each context tries.", ge=1, le=10**9)
    longest: int = option(100,
        "Largest number of instants (50 ms each) of a segment that the search uses.", ge=1, le=10**9)
    steps: int = option(500, "Number of gradient steps of the classifier's training.", ge=1, le=10**9)
    seed: Seed
    # fmt: on


def learn(
    demonstrations: List[Demonstration], options: AppldOptions, arguments: Sequence[str], say=print
) -> Dict[str, Any]:
    """Writes the file options.out and its log beside it (OUT_log.json); returns the log.

    Args:
        demonstrations: to learn from.
        options: how.
        arguments: the command line, for the log.
        say: takes a line of progress.
    """
    began = time.monotonic()
    found = contexts.find(demonstrations, options.contexts, options.penalty)
    for s in found.segments:
        d = demonstrations[s.demonstration]
        say(f"{d.name} {d.time[s.first]:5.1f} to {d.time[s.last - 1]:5.1f} s: context {found.names[s.context]}")
    space, layout = space_of(options.robot), layout_of(options.robot)
    fits = _fits(demonstrations, found, options, say)
    labels = [np.full(s.last - s.first, s.context) for s in found.segments]
    scans = [demonstrations[s.demonstration].seen[s.first : s.last] for s in found.segments]
    weights, classifier = appld_classifier.train(
        appld_classifier.inputs(np.concatenate(scans), layout),
        np.concatenate(labels),
        len(found.names),
        options.seed,
        options.steps,
        layout,
    )
    say(f"classifier: {classifier['accuracy']} of the instants right, {classifier['held_out']} of those held out")
    log = {
        "command": "python -m training.appld " + " ".join(map(_plain, arguments)),
        "demonstrations": [dict(d.source, bag=d.name, seconds=round(float(d.time[-1]), 2)) for d in demonstrations],
        "segments": [dict(s._asdict(), context=found.names[s.context]) for s in found.segments],
        "contexts": [
            {
                "name": name,
                "features": dict(zip(contexts.FEATURES, mean.round(3).tolist())),
                "parameters": space.as_dict(f.theta),
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
        "classifier": classifier,
        "seconds": round(time.monotonic() - began, 1),
    }
    make_folder(Path(options.out).parent)
    short = {key: log[key] for key in ("command", "demonstrations", "classifier")}
    sets = {name: space.pick(f.theta) for name, f in zip(found.names, fits)}
    actor.save_contexts(options.out, sets, weights, {"training": short}, space, layout)
    write_json(Path(options.out).with_suffix("").as_posix() + "_log.json", log)
    return log


def _fits(demonstrations, found, options, say) -> List[appld_fit.Fit]:
    """The parameters of each context."""
    stretches: List[List[appld_fit.Stretch]] = [[] for _ in found.names]
    for index, d in enumerate(demonstrations):
        spans = [s for s in found.segments if s.demonstration == index]
        for s, stretch in zip(spans, appld_fit.stretches(d, spans, options.longest)):
            stretches[s.context].append(stretch)
    fits = []
    for k, (name, own) in enumerate(zip(found.names, stretches)):
        fits.append(appld_fit.fit(own, options.evaluations, options.seed + k))
        last = fits[-1]
        values = {n: round(value, 3) for n, value in space_of(options.robot).as_dict(last.theta).items()}
        say(
            f"context {name}: loss {last.loss:.4f} (theta_0: {last.loss_theta0:.4f}), rms {last.error[0]:.2f} m/s "
            f"{last.error[1]:.2f} rad/s, {last.evaluations} replays of {last.instants} instants: {values}"
        )
    return fits


def _plain(word: str) -> str:
    """A path as it goes into the log: without this machine's folders."""
    return Path(word).name if word.startswith(("/", "~")) else word
