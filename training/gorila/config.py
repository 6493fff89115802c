"""Every option of train.py, once: name, default, type and sentence. The command line and the checks follow from it."""

from __future__ import annotations

import argparse
import json
import math
import sys
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Dict, List, Optional, get_type_hints

import yaml

from training.gorila.learner import LearnerConfig
from training.mdp.episode import PERIOD
from training.mdp.reward import Reward
from training.storage import StorageError, read_bytes, read_json
from training.td3.td3 import TD3Config

PAPER_STEPS = 5_000_000
RECIPES = Path(__file__).resolve().parents[1] / "recipes"
MOST_ROWS = 10**8
MOST = {"scan_noise": 1000.0, "latency": 2.0, "friction": 100.0, "slip": 10.0}  # of what is randomised


class ConfigError(ValueError):
    """An option that cannot be meant; one line with the option, its value and the remedy."""


def option(default, doc: str, choices=None, **more):
    return field(default=default, metadata=dict(doc=doc, choices=choices, **more))


@dataclass(frozen=True)
class TrainConfig:
    """Defaults are the paper's, or the authors' code's where the paper is silent (training/td3/td3.py names deviations)."""  # noqa: E501

    # -- what and where
    out: str = option("runs/applr", "folder of the run: checkpoints, journal, curves, actors")
    resume: bool = option(False, "go on with the run in --out, with its options; options given again replace them")
    steps: int = option(PAPER_STEPS, "transitions (decisions) to collect in all; the paper's 5 million")
    seed: int = option(0, "of everything drawn at random")
    device: str = option("auto", "where the learner computes: cpu, cuda, auto")
    threads: int = option(0, "of the learner on the CPU; 0: the cores that the actors leave, at least one")
    # -- actors
    actors: int = option(0, "episodes driven at once; 0: one after the other in this process, the same in every run")
    pool: str = option("ray", "what the actors are", choices=("ray", "processes"))
    ray_address: str = option("", "HOST:PORT of a Ray cluster; empty: Ray on this machine")
    publish_every: int = option(25, "gradient steps between two policies handed to the actors")
    max_staleness: int = option(
        0, "refuse episodes of policies older than so many gradient steps; 0: take all, their age is reported"
    )
    # -- worlds and robot
    period: float = option(PERIOD, "decision period [s]: time between two choices of the parameters (paper: 2)")
    env: str = option(
        "training.mdp.env:ApplrEnv", "the environment, MODULE:CLASS; one that is not ours gets no arguments"
    )
    worlds: str = option(
        "generated:learn",
        "worlds to train in: a specification, several with commas between them; generated:learn are the training "
        "worlds less those of generated:validation",
    )
    simulator: str = option("kinematic", "to train in", choices=("kinematic", "pybullet"))
    curriculum: float = option(0.0, "share of the steps over which harder worlds come in, after the easiest quarter")
    start_xy: float = option(0.0, "the start is moved by up to this much [m]")
    start_yaw: float = option(0.0, "and turned by up to this much [rad]")
    scan_noise: str = option("1", "multiplies the laser's noise; LOW,HIGH: drawn at each reset (so the next three)")
    latency: str = option("0", "of commands [s]")
    friction: str = option("1", "multiplies the wheels' friction")
    slip: str = option("1", "multiplies slip and drift")
    # -- reward (training/mdp/reward.py)
    c_f: float = option(Reward.c_f, "reward: each decision before the goal costs this")
    c_p: float = option(Reward.c_p, "reward: each metre towards the goal brings this")
    c_c: float = option(Reward.c_c, "reward: 1/d to the nearest obstacle costs this")
    along_y: bool = option(False, "reward: progress along y, as the paper simplified it, not towards the goal")
    exact_time: bool = option(False, "reward: R_f counts seconds, the last decision's too, not whole decisions")
    lowest: bool = option(False, "reward: d from all scans of the decision, not from its last")
    c_contact: float = option(0.0, "reward: a decision with a contact costs this")
    c_switch: float = option(0.0, "reward: changing parameters (mean, action units) costs this")
    c_jerk: float = option(0.0, "reward: 10 m/s^3 of mean jerk cost this")
    # -- TD3
    hidden: str = option("512,512,512", "units of the hidden layers")
    actor_lr: float = option(TD3Config.actor_lr, "learning rate of the policy")
    critic_lr: float = option(TD3Config.critic_lr, "learning rate of the critics")
    gamma: float = option(TD3Config.gamma, "discount per decision")
    n_step: int = option(TD3Config.n_step, "steps of the returns")
    batch_size: int = option(TD3Config.batch_size, "transitions of a gradient step")
    tau: float = option(TD3Config.tau, "how fast the targets follow")
    target_noise: float = option(TD3Config.target_noise, "smoothing noise on target actions")
    noise_clip: float = option(TD3Config.noise_clip, "its bound")
    saturation: float = option(
        TD3Config.saturation,
        "cost of the policy's mean square output before tanh: keeps it "
        "off the ends of the ranges, where no gradient comes through",
    )
    average: float = option(
        TD3Config.average,
        "hand out the policy's running average, with this decay per policy step, like .999; 0: the policy itself",
    )
    scan_pool: int = option(
        TD3Config.scan_pool,
        "neighbouring beams whose mean enters the networks as one input; 5 makes 144 inputs of 720 beams "
        "and a gradient step four times faster; the actor file still takes every beam",
    )
    layer_norm: bool = option(
        TD3Config.layer_norm, "normalise the hidden layers of the critics, which steadies many gradient steps"
    )
    policy_delay: int = option(TD3Config.policy_delay, "critic steps per policy step")
    updates_per_transition: float = option(LearnerConfig.updates_per_transition, "gradient steps per transition")
    mirror: bool = option(False, "half of each batch left for right, scan and local goal: twice the experience")
    warmup: int = option(0, "transitions with uniformly random actions before the first gradient step (paper: none)")
    capacity: int = option(0, "rows of the replay, one per observation; 0: a tenth more than --steps, so all of them")
    noise_start: float = option(0.5, "standard deviation of the exploration noise at the beginning")
    noise_end: float = option(0.02, "and at the end")
    noise_steps: int = option(
        0,
        "transitions over which it falls; 0: the paper's 3.84 million, in proportion "
        "where --steps is under 5 million (a deviation)",
    )
    # -- offline
    dataset: str = option(
        "", "folder of a dataset (training/experience/dataset.py): learn offline from it; --mix: from both"
    )
    mix: bool = option(False, "take --dataset into the replay, then train online")
    updates: int = option(100_000, "gradient steps of offline learning")
    bc_alpha: float = option(0.0, "TD3+BC's alpha (2.5 in its paper); 0: plain TD3")
    # -- keeping and looking
    checkpoint_every: float = option(120.0, "seconds between checkpoints")
    eval_worlds: str = option(
        "generated:validation",
        "worlds of the periodic evaluation, which chooses the best actor; the default is a part of the training "
        "worlds that --worlds leaves out, so that no test world takes part in the choice; none: no evaluation",
    )
    eval_count: int = option(0, "how many of them, evenly spread; 0: all")
    eval_trials: int = option(1, "trials in each")
    eval_every: int = option(50_000, "transitions (offline: gradient steps) between evaluations")
    eval_simulator: str = option("", "of the evaluation; empty: the training's", choices=("", "kinematic", "pybullet"))
    contact_seconds: float = option(5.0, "what a contact adds to a trial's time when the best actor is chosen [s]")
    tensorboard: bool = option(True, "write TensorBoard events")

    def __post_init__(self):
        for f in fields(self):
            value = getattr(self, f.name)
            choices = f.metadata["choices"]
            if choices and value not in choices:
                raise ConfigError("--%s is %r: give %s" % (dashed(f.name), value, " or ".join(c for c in choices if c)))
            if isinstance(value, float) and not math.isfinite(value):
                raise ConfigError("--%s is %r: give a finite number" % (dashed(f.name), value))
        for name, low, high in _BOUNDS:
            value = getattr(self, name)
            if not low <= value <= high:
                raise ConfigError("--%s is %r: give %s to %s" % (dashed(name), value, low, high))
        self.layers()
        for name in ("scan_noise", "latency", "friction", "slip"):
            self._span(name)
        if self.mix and not self.dataset:
            raise ConfigError("--mix needs a --dataset")

    # -- what the parts need
    def layers(self) -> List[int]:
        try:
            sizes = [int(part) for part in self.hidden.split(",")]
        except ValueError:
            sizes = []
        if not 1 <= len(sizes) <= 15 or not all(1 <= n <= 8192 for n in sizes):
            raise ConfigError("--hidden is %r: give 1 to 15 sizes of 1 to 8192, like 512,512,512" % (self.hidden,))
        return sizes

    def learner(self) -> LearnerConfig:
        td3 = TD3Config(
            hidden=tuple(self.layers()),
            **{f.name: getattr(self, f.name) for f in fields(TD3Config) if f.name != "hidden"},
        )
        capacity = self.capacity or min(MOST_ROWS, max(1000, int(1.1 * self.steps) + 1000))
        return LearnerConfig(
            td3=td3,
            capacity=capacity,
            updates_per_transition=self.updates_per_transition,
            warmup=self.warmup,
            mirror=self.mirror,
            max_staleness=self.max_staleness,
            seed=self.seed,
            device=self.device,
        )

    def resolved(self) -> "TrainConfig":
        """With what depends on --steps written out, so that a longer --steps at a --resume does not change it."""
        papers = (0.5 - 0.02) / 0.125 * 1e6
        return replace(
            self,
            capacity=self.learner().capacity,
            noise_steps=self.noise_steps or max(1, int(papers * min(1.0, self.steps / PAPER_STEPS))),
        )

    def reward(self) -> Dict[str, Any]:
        return {f.name: getattr(self, f.name) for f in fields(Reward)}

    def randomisation(self) -> Dict[str, Any]:
        return dict(
            start_xy=self.start_xy,
            start_yaw=self.start_yaw,
            **{name: self._span(name) for name in ("scan_noise", "latency", "friction", "slip")},
        )

    def noise(self, transitions: int) -> float:
        """Exploration noise after so many transitions (of a resolved configuration)."""
        fall = (self.noise_start - self.noise_end) * transitions / self.noise_steps
        return max(self.noise_end, self.noise_start - fall)

    def _span(self, name):
        text = getattr(self, name)
        try:
            numbers = [float(part) for part in str(text).split(",")]
            if (
                len(numbers) not in (1, 2)
                or not all(0 <= n <= MOST[name] for n in numbers)
                or numbers != sorted(numbers)
            ):
                raise ValueError
        except ValueError:
            raise ConfigError(
                "--%s is %r: give a number from 0 to %g, or LOW,HIGH" % (dashed(name), text, MOST[name])
            ) from None
        return numbers[0] if len(numbers) == 1 else numbers


_BOUNDS = (
    ("steps", 0, 10**9),
    ("seed", 0, 2**31 - 1),
    ("threads", 0, 1024),
    ("actors", 0, 10_000),
    ("publish_every", 1, 10**9),
    ("max_staleness", 0, 10**9),
    ("curriculum", 0.0, 1.0),
    ("start_xy", 0.0, 10.0),
    ("start_yaw", 0.0, math.pi),
    ("actor_lr", 0.0, 1.0),
    ("critic_lr", 0.0, 1.0),
    ("gamma", 0.0, 1.0),
    ("n_step", 1, 100),
    ("batch_size", 1, 65536),
    ("tau", 0.0, 1.0),
    ("target_noise", 0.0, 2.0),
    ("noise_clip", 0.0, 2.0),
    ("average", 0.0, 0.999999),
    ("saturation", 0.0, 100.0),
    ("period", 0.05, 10.0),
    ("scan_pool", 1, 1000),
    ("policy_delay", 1, 100),
    ("updates_per_transition", 0.0, 100.0),
    ("warmup", 0, 10**9),
    ("capacity", 0, MOST_ROWS),
    ("noise_start", 0.0, 2.0),
    ("noise_end", 0.0, 2.0),
    ("noise_steps", 0, 10**9),
    ("updates", 0, 10**9),
    ("bc_alpha", 0.0, 1000.0),
    ("checkpoint_every", 0.0, 1e6),
    ("eval_count", 0, 100_000),
    ("eval_trials", 1, 1000),
    ("eval_every", 1, 10**9),
    ("contact_seconds", 0.0, 1e6),
)
FIXED = {"hidden", "capacity", "seed", "env", "scan_pool", "layer_norm"}  # what --resume cannot replace


def dashed(name: str) -> str:
    return name.replace("_", "-")


def parser() -> argparse.ArgumentParser:
    p = _Parser(
        prog="train.py",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
        allow_abbrev=False,
        description="Trains a parameter policy: TD3 with any number of actors (or --actors 0), or offline from "
        "a --dataset. Ctrl-C saves and stops; --resume goes on. Defaults are the paper's.",
    )
    p.add_argument(
        "--recipe",
        metavar="NAME",
        default=argparse.SUPPRESS,
        help="take the options of a recipe, a name among %s or a YAML file; options given beside it replace its own"
        % ", ".join(recipes()),
    )
    types = get_type_hints(TrainConfig)
    for f in fields(TrainConfig):
        flag, kind = "--" + dashed(f.name), types[f.name]
        text = "%s (default: %s)" % (f.metadata["doc"], f.default if f.default != "" else "none")
        if kind is bool:
            p.add_argument(flag, action=argparse.BooleanOptionalAction, default=argparse.SUPPRESS, help=text)
        else:
            p.add_argument(
                flag,
                type=_TYPES[kind],
                default=argparse.SUPPRESS,
                help=text,
                choices=f.metadata["choices"],
                metavar=None if f.metadata["choices"] else f.name.upper(),
            )
    return p


def recipes() -> List[str]:
    """Names of the recipes that come with the package (training/recipes/NAME.yaml)."""
    return sorted(path.stem for path in RECIPES.glob("*.yaml"))


def recipe(name: str) -> Dict[str, Any]:
    """The options of a recipe.

    Args:
        name: one of recipes(), the path of a YAML file of options, or "" for none.

    Raises:
        ConfigError: with one line, for an unknown name or a file that holds anything but options.
    """
    if not name:
        return {}
    path = Path(name) if name.endswith(".yaml") else RECIPES / (name + ".yaml")
    if not name.endswith(".yaml") and name not in recipes():
        raise ConfigError("--recipe %s is unknown: give %s or a .yaml file" % (name, ", ".join(recipes())))
    try:
        values = yaml.safe_load(read_bytes(path).decode())
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ConfigError("%s: not YAML (%s)" % (path, str(error).splitlines()[0])) from None
    if not isinstance(values, dict):
        raise ConfigError("%s: no options; give lines such as `batch_size: 256`" % path)
    return from_dict({str(key).replace("-", "_"): value for key, value in values.items()}, str(path))


class _Parser(argparse.ArgumentParser):
    def error(self, message):
        raise ConfigError("%s; --help lists all options" % message)


def _integer(text: str) -> int:
    try:
        return int(float(text)) if "e" in text.lower() else int(text.replace("_", ""))
    except (ValueError, OverflowError):
        raise argparse.ArgumentTypeError("%r is no whole number" % text) from None


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError("%r is no number" % text) from None


_TYPES = {int: _integer, float: _number, str: str}


def parse(arguments: Optional[List[str]] = None) -> TrainConfig:
    """From the command line. ROS remapping arguments (name:=value) are ignored; --resume brings the run's own options.
    Raises ConfigError or StorageError with one line.
    """
    arguments = sys.argv[1:] if arguments is None else arguments
    given = vars(parser().parse_args([a for a in arguments if ":=" not in a]))
    if not given.get("resume"):
        return TrainConfig(**{**recipe(given.pop("recipe", "")), **given})
    given.pop("recipe", None)  # a run keeps the options that it began with
    out = given.get("out", TrainConfig.out)
    path = Path(out) / "config.json"
    if not path.exists():
        raise ConfigError("--resume: %s holds no run (no config.json); check --out, or leave --resume out" % out)
    stored = from_dict(read_json(path), str(path))
    for name in FIXED & set(given):
        if given[name] != stored[name]:
            raise ConfigError(
                "--%s %s: the run in %s was begun with %s, which cannot be changed"
                % (dashed(name), given[name], out, stored[name])
            )
    return TrainConfig(**{**stored, **given, "out": out})


def from_dict(values: Any, where: str) -> Dict[str, Any]:
    """Checked options of a config.json: known keys, right types."""
    types = get_type_hints(TrainConfig)
    if not isinstance(values, dict):
        raise StorageError("%s: not an options file" % where)
    for name, value in values.items():
        if name not in types:
            raise ConfigError("%s: unknown option %r" % (where, name))
        if type(value) is not types[name] and not (types[name] is float and type(value) is int):
            raise ConfigError("%s: %s is %s, %s needed" % (where, name, json.dumps(value), types[name].__name__))
    return dict(values)
