"""What may follow the training of a policy: a partner's training, the mean of the two, and their refinement.

train.py does these one after the other. Each continues where it was stopped.
"""

from __future__ import annotations

import os
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any, Dict, Optional

from applr_ros1.robots import load
from training import refine_policy
from training.choose_policy import write_mean
from training.command_line import end_at_sigterm
from training.gorila.config import FIXED, ConfigError, TrainConfig, parse, recipe
from training.gorila.preparation import prepare

SHARED = ("device", "threads", "actors", "pool", "ray_address", "robot", "symmetric", "tensorboard")
NOTHING: Dict[str, Any] = {"partner": "", "refine": 0}  # options with which nothing follows a training
ALIKE = {"env": "environment", "period": "decision period", "weights": "kind of distance weights"}


def partner_of(config: TrainConfig) -> Optional[TrainConfig]:
    """The configuration of the run that trains the partner; None where none is asked for.

    Raises:
        ApplrError: with one line, for a recipe that cannot be trained, or whose policy could not be averaged with the
            run's.
    """
    if not config.partner:
        return None
    out = str(Path(config.out) / "partner")
    if config.resume and (Path(out) / "config.json").exists():
        begun = parse(["--resume", "--out", out])
        partner = replace(begun, **{name: getattr(config, name) for name in SHARED if name not in FIXED})
        recipe_then = parse(["--resume", "--out", config.out]).partner or config.partner
        if config.partner != recipe_then:
            raise ConfigError(
                "--partner %s: the partner in %s was begun with the recipe %s, which cannot be changed"
                % (config.partner, out, recipe_then)
            )
    else:
        given = {**recipe(config.partner), **{name: getattr(config, name) for name in SHARED}}
        partner = TrainConfig(**{**given, "out": out, "seed": config.seed + 1, **NOTHING})
    for name, what in ALIKE.items():
        if getattr(partner, name) != getattr(config, name):
            raise ConfigError(
                "--partner %s: its %s is %s, that of this run %s; give a recipe with the same one"
                % (config.partner, what, getattr(partner, name), getattr(config, name))
            )
    if len(partner.layers()) != len(config.layers()):
        raise ConfigError(
            "--partner %s: its networks have %d hidden layers, those of this run %d; give a recipe with as many"
            % (config.partner, len(partner.layers()), len(config.layers()))
        )
    made = prepare(partner)  # finds its mistakes now, not after the first training
    partner.learner().td3.check(made.layout.size, made.layout.action, made.layout.scan)
    return partner


def what_follows(config: TrainConfig, partner: Optional[TrainConfig]) -> str:
    """A line that says what comes after the training, which --minutes and --steps do not count; "" for nothing."""
    parts = []
    if partner:
        limit = " (%g min)" % partner.minutes if partner.minutes else ""
        parts.append("a second one with the recipe %s%s" % (config.partner, limit))
    if config.refine:
        parts.append("a refinement of %d step%s" % (config.refine, "" if config.refine == 1 else "s"))
    if not parts:
        return ""
    return 'after this training: %s; --partner "" --refine 0 leaves out what follows' % ", then ".join(parts)


def last_policy(config: TrainConfig, partner: Optional[TrainConfig]) -> str:
    """The file of the policy that training ended with; with a partner that of the mean, which is written here."""
    policies = [each.out + "/actor.safetensors" for each in (config, partner) if each]
    if len(policies) == 1:
        return policies[0]
    mean = config.out + "/mean.safetensors"
    write_mean(mean, policies, load(config.robot))
    return mean


def refine(config: TrainConfig, policy: str) -> None:
    """Refines a policy of the run with training.refine_policy, and says with which command.

    Raises:
        ApplrError: with one line; what was driven so far is kept.
    """
    out, driven, workers = config.out, config.evaluation(), max(1, config.actors)
    if config.ray_address:  # the actors are a cluster's, the refinement drives on this machine alone
        workers = min(workers, len(os.sched_getaffinity(0)))
    arguments = [
        *(policy, "--out", out + "/refined.safetensors", "--results", out + "/refinement"),
        *("--steps", str(config.refine), "--workers", str(workers), "--seed", str(config.seed)),
        *("--robot", config.robot, "--simulator", driven["simulator"]),
        *("--weights", driven["weights"], "--planner", driven["planner"]),
        *("--contact-seconds", str(config.contact_seconds), *["--monitor"] * config.monitor),
    ]
    print("refining: python -m training.refine_policy %s" % shlex.join(arguments), flush=True)
    end_at_sigterm()
    try:
        refine_policy.run(arguments)
    except KeyboardInterrupt:
        raise KeyboardInterrupt("stopped; --resume continues the refinement") from None
