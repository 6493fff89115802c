"""The configuration of a training run: checked options, the command line, recipes, and what a run stored.

The options themselves stand in options.py. train.py and the parts that it starts use this.
"""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Callable, Dict, List, Optional, Tuple, get_type_hints

import yaml

import sim_bridge
from applr_ros1.common.arguments import without_remappings
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import StorageError, read_bytes, read_json
from applr_ros1.planner.variant import PER_CELL, PER_METRE
from applr_ros1.policy import methods
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots import load
from training.gorila.learner import LearnerConfig
from training.gorila.options import PAPER_STEPS, Options
from training.mdp.reward import Reward
from training.td3.td3 import TD3Config

RECIPES = Path(__file__).resolve().parents[1] / "recipes"
MOST_ROWS = 10**8
KINDS = {  # of values in a file of options, in words
    str: "a text, in quotes where YAML or JSON would read it as something else",
    int: "a whole number",
    float: "a number",
    bool: "true or false",
    list: "a list",
    dict: "names with values",
}
PROVENANCE = "provenance"  # in config.json, beside the options (training/provenance.py)
MOST = {"scan_noise": 1000.0, "latency": 2.0, "friction": 100.0, "slip": 10.0}  # of what is randomised


class ConfigError(ApplrError):
    """An option that cannot be meant; one line with the option, its value and the remedy."""

    exit_status = 2


@dataclass(frozen=True)
class TrainConfig(Options):
    """The options of a run, checked, and what its parts need of them.

    Raises:
        ConfigError: with one line, for a value that cannot be meant.
    """

    def __post_init__(self):
        for f in fields(self):
            value = getattr(self, f.name)
            choices = f.metadata["choices"]
            if choices and value not in choices:
                raise ConfigError("--%s is %r: give %s" % (dashed(f.name), value, " or ".join(c for c in choices if c)))
            if isinstance(value, float) and not math.isfinite(value):
                raise ConfigError("--%s is %r: give a finite number" % (dashed(f.name), value))
        for name, value in (("simulator", self.simulator), ("eval_simulator", self.eval_simulator or self.simulator)):
            if not sim_bridge.is_name(value):
                known = " or ".join(sim_bridge.NAMES)
                raise ConfigError("--%s is %r: give %s, or MODULE:CLASS" % (dashed(name), value, known))
        for name, low, high in _BOUNDS:
            value = getattr(self, name)
            if not low <= value <= high:
                raise ConfigError("--%s is %r: give %s to %s" % (dashed(name), value, low, high))
        load(self.robot)
        self.layers()
        for name in ("scan_noise", "latency", "friction", "slip"):
            self._span(name)
        if self.actors and 0 < self.max_staleness < self.publish_every:  # all episodes would be too old before long
            raise ConfigError(
                "--max-staleness is %d, but the actors get a new policy every %d gradient steps only: give %d or more, "
                "or a smaller --publish-every" % (self.max_staleness, self.publish_every, self.publish_every)
            )
        if self.mix and not self.dataset:
            raise ConfigError("--mix needs a --dataset")
        if (self.refine or self.partner) and self.env != Options.env:
            raise ConfigError("--refine and --partner are for the navigation task: leave them out, or --env")
        if self.mirror and self.env != Options.env:
            raise ConfigError("--mirror is for the observations of the navigation task: leave it out, or --env")

    # -- what the parts need
    def layers(self) -> List[int]:
        """Sizes of the hidden layers. Raises ConfigError."""
        try:
            sizes = [int(part) for part in self.hidden.split(",")]
        except ValueError:
            sizes = []
        if not 1 <= len(sizes) <= 15 or not all(1 <= n <= 8192 for n in sizes):
            raise ConfigError("--hidden is %r: give 1 to 15 sizes of 1 to 8192, like 512,512,512" % (self.hidden,))
        return sizes

    def learner(self) -> LearnerConfig:
        """The learner's own options: networks, gradient steps and replay buffer."""
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
            start=self.start_action(),
            start_run=self.start_run,
        )

    @property
    def start_run(self) -> str:
        """Folder of the run that --start names; "" where it names a method, a JSON file, or nothing."""
        return "" if self.start in methods.METHODS or self.start.endswith(".json") else self.start

    def start_action(self) -> Tuple[float, ...]:
        """The action of the set --start, () without one. Raises ConfigError, or ApplrError for a file of no use.

        A run that has saved a checkpoint goes on from that and needs the set no more.
        """
        if not self.start or self.resume and (Path(self.out) / "checkpoint.json").exists():
            return ()
        known = "static, a JSON file with a parameter set, or the folder of a training run that has saved a checkpoint"
        if self.start_run:
            if not self.resume and not (Path(self.start_run) / "checkpoint.json").exists():
                raise ConfigError("--start is %r: give %s" % (self.start, known))
            return ()
        robot = load(self.robot)
        method = methods.make(methods.for_weights(self.start, self.weights, robot), robot)
        if not isinstance(method, methods.FixedParameters):
            raise ConfigError("--start is %r: give %s" % (self.start, known))
        if {method.weights, self.weights} == {PER_CELL, PER_METRE}:
            raise ConfigError(
                "--start %s: its distance weights count %s, those of the run %s: give a set of the same kind"
                % (self.start, method.weights, self.weights)
            )
        return tuple(space_of(robot).to_action(method.values).tolist())

    def resolved(self) -> "TrainConfig":
        """With what depends on --steps written out, so that a longer --steps at a --resume does not change it."""
        papers = (0.5 - 0.02) / 0.125 * 1e6
        return replace(
            self,
            capacity=self.learner().capacity,
            noise_steps=self.noise_steps or max(1, int(papers * min(1.0, self.steps / PAPER_STEPS))),
        )

    def reward(self) -> Dict[str, Any]:
        """Fields of the Reward."""
        return {f.name: getattr(self, f.name) for f in fields(Reward)}

    def randomisation(self) -> Dict[str, Any]:
        """Fields of the simulators' Randomisation."""
        return dict(
            start_xy=self.start_xy,
            start_yaw=self.start_yaw,
            **{name: self._span(name) for name in ("scan_noise", "latency", "friction", "slip")},
        )

    def evaluation(self) -> Dict[str, str]:
        """What the periodic evaluation drives with: simulator, weights and planner, always at the robot's own rates."""
        return {
            name: getattr(self, "eval_" + name) or getattr(self, name) for name in ("simulator", "weights", "planner")
        }

    def setting(self) -> str:
        """What the periodic evaluation drives with, in words: results of another setting cannot be compared."""
        monitor = ["collision monitor"] * self.monitor
        return ", ".join([self.eval_worlds, *self.evaluation().values(), *monitor])

    def noise(self, transitions: int) -> float:
        """Exploration noise after so many transitions (of a resolved configuration)."""
        share = min(1.0, transitions / self.noise_steps)
        return (1.0 - share) * self.noise_start + share * self.noise_end

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
    ("minutes", 0.0, 1e6),
    ("seed", 0, 2**31 - 1),
    ("threads", 0, 1024),
    ("actors", 0, 10_000),
    ("publish_every", 1, 10**9),
    ("max_staleness", 0, 10**9),
    ("planner_frequency", 0, 20),
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
    ("critics", 2, 1000),
    ("bins", 0, 10_000),
    ("value_low", -1e6, 1e6),
    ("value_high", -1e6, 1e6),
    ("noise_held", 0.0, 1.0),
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
    ("refine", 0, 16),
)
# what --resume cannot replace
FIXED = {
    *("hidden", "capacity", "seed", "env", "robot", "scan_pool", "layer_norm"),
    *("critics", "bins", "value_low", "value_high", "start"),
}


def dashed(name: str) -> str:
    """An option's name as the command line spells it."""
    return name.replace("_", "-")


def parser() -> argparse.ArgumentParser:
    """The command line, from the fields of TrainConfig. A mistake raises ConfigError."""
    p = _Parser(
        prog="train.py",
        allow_abbrev=False,
        description="Trains a policy that sets the planner's parameters, with TD3: online with actors that drive in "
        "simulation, or offline from a --dataset. Ctrl-C saves the run and stops; --resume continues it.",
        epilog="Defaults are the paper's; where the paper is silent, those of its authors' code. docs/training.md "
        "describes the learning problem, the files of a run, and each deviation.",
    )
    p.add_argument(
        "--recipe",
        metavar="NAME",
        default=argparse.SUPPRESS,
        help="Use the options of a recipe: one of %s, or a YAML file of options. Options given beside it replace those "
        "of the recipe." % ", ".join(recipes()),
    )
    types = get_type_hints(TrainConfig)
    group: argparse._ActionsContainer = p
    for f in fields(TrainConfig):
        if f.metadata["group"]:
            group = p.add_argument_group(f.metadata["group"])
        flag, kind = "--" + dashed(f.name), types[f.name]
        text = f.metadata["doc"] + ("" if f.default == "" else " Default: %s." % f.default)
        if kind is bool:
            group.add_argument(flag, action=argparse.BooleanOptionalAction, default=argparse.SUPPRESS, help=text)
        else:
            group.add_argument(
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


def _real(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError("%r is no number" % text) from None


_TYPES: Dict[type, Callable[[str], Any]] = {int: _integer, float: _real, str: str}


def parse(arguments: Optional[List[str]] = None) -> TrainConfig:
    """The configuration that a command line asks for; with --resume the options that the run was begun with.

    Args:
        arguments: without the program's name; None: those of this process. ROS's remappings (name:=value) are ignored.

    Raises:
        ConfigError, StorageError: with one line.
    """
    given = vars(parser().parse_args(without_remappings(arguments)))
    if not given.get("resume"):
        return TrainConfig(**{**recipe(given.pop("recipe", "")), **given})
    recipe(given.pop("recipe", ""))  # there must be one; but a run keeps the options that it began with
    out = given.get("out", TrainConfig.out)
    path = Path(out) / "config.json"
    if not path.exists():
        raise ConfigError("--resume: %s holds no run (no config.json); check --out, or leave --resume out" % out)
    kept = read_json(path)
    if isinstance(kept, dict):
        kept.pop(PROVENANCE, None)
    stored = {"weights": PER_METRE, **from_dict(kept, str(path))}  # older runs had no choice
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
            raise ConfigError("%s: %s is %s; give %s" % (where, name, json.dumps(value), KINDS[types[name]]))
    return dict(values)
