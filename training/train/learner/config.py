"""Options of ./applr train: groups, the command line, recipes, and the stored options of a run.

Defaults are the paper's. If the paper gives no value, they are those of its authors' code.
train/td3/td3.py and docs/explanation/learning_problem.md list deviations.
"""

from __future__ import annotations

import math
from functools import cached_property
from pathlib import Path
from typing import Any, Dict, List, Literal, Optional, Tuple

from pydantic import ConfigDict

from applr_ros1.common.arrays import Array
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import read_json, read_yaml, reading
from applr_ros1.planner.variant import OURS
from applr_ros1.policy import actor, methods
from applr_ros1.policy.decision import PERIOD
from applr_ros1.policy.dimensionless import ENCODINGS
from applr_ros1.policy.encoding import PAPER as PAPER_ENCODING
from applr_ros1.policy.stuck import STALL_DISTANCE_M, STALL_TIME_S
from training.common import command_line
from training.common.command_line import RayAddress, Seed
from training.common.folders import make_folder
from training.common.options import Options, checked, dashed, option
from training.env.reward import Reward, RewardOptions
from training.env.settings import CHALLENGE, DRAWN, DriveSettings
from training.train.td3.options import TD3Options
from worlds.loading import SPECIFICATIONS

_RECIPES_FOLDER = Path(__file__).resolve().parents[1] / "recipes"
RECIPES = {path.stem: path for path in sorted(_RECIPES_FOLDER.glob("*.yaml"))}
# Key in config.json for the provenance of each session (training/common/provenance.py)
PROVENANCE = "provenance"
PAPER_STEPS = 5_000_000  # number of transitions in the paper
# Options that --resume cannot change
FIXED = (
    "recipe",
    "robot",
    "observation",
    "critics_know_more",
    "seed",
    "init_from",
    "net_arch",
    "layer_norm",
    # Rewards of one problem are not those of another.
    "decision_period",
    *RewardOptions.model_fields,
    # Conditions of the evaluations
    "eval_worlds",
    "protocol",
    "planner",
    "monitor",
    "matched",
    "movers",
)
ABOUT = """Trains a policy that sets the planner's parameters, with TD3: online with actors that
drive in simulation, or offline from a --dataset. Ctrl-C saves the run and stops; --resume
continues it.

Defaults are the paper's. If the paper gives no value, they are those of its authors' code.
docs/explanation/learning_problem.md describes the learning problem and each deviation."""
# Options that may be an interval: fields of Randomisation
SPANS = ("scan_noise", "latency", "slip", "friction", "ground", "odometry")


def span(default: float, help: str, remark: str = "") -> Any:
    """Declare an option of SPANS: a number, or two between which each reset draws a value."""
    text = f"{help} Two numbers: a value between them is drawn at each reset{remark}."
    return option([default], text, min_length=1, max_length=2)


class RunOptions(Options):
    """Folder and length of a run."""

    model_config = ConfigDict(title="The run")

    # fmt: off
    recipe: str = option("",
        f"Use the options of a recipe: one of {', '.join(RECIPES)}, or a YAML file of options. "
        "Explicit options override those of the recipe.")
    out: str = option("runs/applr",
        "Folder for the configuration, the checkpoints, all trajectories, the policies, and the "
        "learning curves.")
    resume: bool = option(False,
        "Continue the run in the folder --out with its stored options. Explicit options replace "
        "the stored ones, but recipe, robot, observation, networks, seed, --init-from, decision "
        "period, reward and the conditions of the evaluations cannot change.")
    total_timesteps: int = option(PAPER_STEPS,
        "Total number of transitions to collect, one per decision. The paper used 5 million.",
        ge=0, le=10**9)
    minutes: float = option(0.0,
        "Wall time [min], without interruptions, after which the run ends even before "
        "--total-timesteps. 0 sets no limit.", ge=0, le=1e6)
    seeds: int = option(1,
        "Number of trainings, one after the other, with the seeds from --seed on. The trainings "
        "share --minutes. Their best policies drive fresh courses. The best one is kept and "
        "compared with the robot's default parameters.",
        ge=1, le=100)
    # fmt: on


class ActorOptions(Options):
    """Collection of experience."""

    model_config = ConfigDict(title="Actors")

    # fmt: off
    actors: int = option(0,
        "Number of actors that drive episodes in parallel, as child processes. 0 drives one "
        "episode after the other in the learner's process; the same seed then gives the same "
        "numbers in every run.", ge=0, le=10_000)
    ray_address: RayAddress
    exploration_noise_initial: float = option(0.5,
        "Standard deviation of the exploration noise at the beginning, for actions from -1 to 1.",
        ge=0, le=2)
    exploration_noise_final: float = option(0.02,
        "Standard deviation of the exploration noise from --exploration-noise-steps transitions "
        "on.", ge=0, le=2)
    exploration_noise_steps: int = option(0,
        "Number of transitions over which the exploration noise changes from its initial to its "
        "final value. 0 uses the paper's 3.84 million, or proportionally fewer if "
        "--total-timesteps is below 5 million.", ge=0, le=10**9)
    # fmt: on


class TaskOptions(DriveSettings):
    """Worlds, observations, and random differences between episodes."""

    model_config = ConfigDict(title="Worlds and episodes")

    # fmt: off
    worlds: str = option("generated:learn",
        f"Worlds to train in: {SPECIFICATIONS}; several are separated by commas. generated:learn "
        "are the training worlds without those of generated:validation.")
    decision_period: float = option(PERIOD,
        "Simulated time [s] between two choices of the parameters. The paper used 2.",
        ge=0.05, le=10)
    observation: Literal["paper", "dimensionless"] = option("paper",
        "Encoding of observations and actions: paper, the capped scan, the direction of the "
        "local goal and the robot's parameter space; or dimensionless, relative to its size and "
        "speed (applr_ros1/policy/dimensionless.py).")
    end_on_collision: bool = option(False,
        "End a training episode at the first collision, as a failure, also with the paper's "
        "protocol. Evaluations are not affected.")
    end_on_stall: bool = option(False,
        "End a training episode, as a failure, if the robot has moved less than "
        f"{STALL_DISTANCE_M:g} m in {STALL_TIME_S:g} s, at the Jackal's scale. Evaluations are not "
        "affected.")
    critics_know_more: bool = option(False,
        "Show the critics what the policy cannot know: the true course ahead, moving obstacles, "
        "planner, ground, friction and delays (training/env/privileged.py).")
    start_xy: float = option(0.0,
        "Largest random displacement [m] of the start position along x and along y.", ge=0, le=10)
    start_yaw: float = option(0.0,
        "Largest random rotation [rad] of the start heading.", ge=0, le=math.pi)
    scan_noise: List[float] = span(1.0, "Factor on the standard deviation of the laser's noise.")
    latency: List[float] = span(0.0, "Delay [s] of the velocity commands.")
    slip: List[float] = span(1.0, "Factor on the slip and drift of the base.")
    friction: List[float] = span(1.0, "Factor on the wheels' friction.")
    ground: List[float] = span(1.0,
        "Blend of ground friction: 0 is ground plain, 1 or more is the ground in the robot's "
        "description.",
        ". With 0 2, half of the episodes have the robot's ground, and the others a blend")
    odometry: List[float] = span(1.0, "Factor on the odometry's errors.")
    # fmt: on


class LearnerOptions(TD3Options):
    """Use of the experience, number of gradient steps, and options of TD3."""

    model_config = ConfigDict(title="Learner")

    # fmt: off
    seed: Seed = option(0,
        "Seed of every random draw: network initialisation, exploration noise, batches, worlds "
        "and simulators.")
    utd_ratio: float = option(0.1,
        "Number of gradient steps per collected transition.", ge=0, le=100)
    mirror: bool = option(False,
        "Mirror half of each batch left to right (scan and local goal). This doubles the "
        "experience, because robot, planner and parameters are symmetric.")
    learning_starts: int = option(0,
        "Number of transitions with uniformly random actions before the first gradient step. The "
        "paper has none. With --init-from, these transitions are driven by the policy with "
        "exploration noise.", ge=0, le=10**9)
    # fmt: on


class OfflineOptions(Options):
    """Learning from a dataset, and start of a run."""

    model_config = ConfigDict(title="Offline learning, and start of a run")

    # fmt: off
    dataset: str = option("",
        "Folder of a dataset (bags_to_dataset.py) from which to learn offline. Without a "
        "dataset, the run is online.")
    gradient_steps: int = option(100_000,
        "Number of gradient steps in offline learning.", ge=0, le=10**9)
    init_from: str = option("",
        "Start of the learning. Folder of another run: its policy, critics and optimisers, "
        "without its experience (period, reward and worlds may differ). static (tuned parameter "
        "set of the robot), dwa (its default parameters) or a JSON file of parameters: the first "
        "output of the policy, and the values of the parameters that a dimensionless policy does "
        "not choose. File of a policy: this policy, frozen for a critic warm-up of 2,000 "
        "gradient steps. The run drives with the obstacle range, and a dimensionless policy with "
        "the values of other parameters, for which the start was made. "
        "Default: a first output near the middle of the ranges.")
    # fmt: on


class PeriodicOptions(Options):
    """Interval and worlds of the policy's evaluation."""

    model_config = ConfigDict(title="Periodic evaluation")

    # fmt: off
    eval_worlds: str = option("generated:validation",
        "Held-out worlds in which the policy is evaluated during the run, to choose the best "
        "policy. The default is a part of the training worlds that --worlds leaves out, so that "
        "no test world affects the choice. Each world is driven once in an evaluation. none "
        "disables the evaluation.")
    eval_freq: int = option(50_000,
        "Number of transitions (offline: gradient steps) between two evaluations.", ge=1, le=10**9)
    # fmt: on


class TrainConfig(
    RunOptions,
    ActorOptions,
    TaskOptions,
    RewardOptions,
    LearnerOptions,
    OfflineOptions,
    PeriodicOptions,
):
    """Checked options of a run, and values derived from them."""

    model_config = ConfigDict(title=None)

    @cached_property
    def start(self) -> Tuple[Optional[Array], Dict[str, float]]:
        """Action (m,) that the untrained policy returns, and values of parameters that none sets.

        The action is None unless --init-from is a parameter set. A resumed run begins at its
        checkpoint, with the values of its own policy.
        """
        if not self.init_from:
            return None, {}
        first_policy = self.own_policy or self.policy_taken_over
        if first_policy is not None:
            return None, first_policy.encoding.base
        is_method = self.init_from in methods.METHODS or self.init_from.endswith(".json")
        if not is_method:
            return None, {}
        method = methods.make(self.init_from, self.robot)
        if not isinstance(method, methods.FixedParameters):
            return None, {}
        encoding = ENCODINGS[self.observation](self.robot, self.decision_period)
        base = {}
        if self.observation != PAPER_ENCODING:  # The paper's encoding sets every parameter.
            for name, value in encoding.space.as_dict(method.values).items():
                if name not in encoding.chosen:
                    base[name] = value
        return encoding.action(method.values), base

    @cached_property
    def own_policy(self) -> Optional[actor.Policy]:
        """Policy that the resumed run has written, or None.

        As with its checkpoint, what a run has written counts more than its start, which may have
        changed or be gone.

        Raises:
            ApplrError: The policy cannot be read.
        """
        own_file = Path(self.out) / "actor.safetensors"
        if not self.resume or not own_file.exists():
            return None
        policy = actor.load(own_file, self.robot)
        assert isinstance(policy, actor.Policy)  # A run writes no contexts.
        return policy

    @cached_property
    def policy_taken_over(self) -> Optional[actor.Policy]:
        """Policy with which the run begins, or None. The learner reports one that does not fit."""
        path = Path(self.init_from)
        if self.init_from and (path / "actor.safetensors").exists():
            path = path / "actor.safetensors"
        if path.suffix != ".safetensors":
            return None
        try:
            method = actor.load(path, self.robot)
        except ApplrError:
            return None
        return method if isinstance(method, actor.Policy) else None

    @cached_property
    def obstacle_range(self) -> Optional[float]:
        """Range [m] for which --init-from was made (Method.obstacle_range), or None.

        The policy learns with the same range, and its file asks for it. A resumed run keeps that of
        its own policy.
        """
        first_policy = self.own_policy or self.policy_taken_over
        if first_policy is not None:
            return first_policy.obstacle_range
        return methods.obstacle_range(self.init_from, self.robot)

    def folder(self) -> Path:
        """Return the folder of the run, made if it is missing.

        Raises:
            ApplrError: The folder already holds a run, which --resume does not continue.
        """
        folder = make_folder(self.out)
        if (folder / "config.json").exists() and not self.resume:
            remedy = "continue it with --resume, or give another --out"
            raise ApplrError(f"{folder} already holds a run: {remedy}")
        return folder

    def environment(self) -> Dict[str, Any]:
        """Return the arguments of the training's environment (ApplrEnv) as JSON values."""
        randomisation: Dict[str, Any] = {"start_xy": self.start_xy, "start_yaw": self.start_yaw}
        for name in SPANS:
            values = getattr(self, name)
            randomisation[name] = values if len(values) == 2 else values[0]
        _, base = self.start
        from_options = {
            *DriveSettings.model_fields,
            "worlds",
            "observation",
            "end_on_collision",
            "end_on_stall",
            "critics_know_more",
        }
        return {
            **self.model_dump(include=from_options),
            "randomisation": randomisation,
            "reward": Reward.of(self).model_dump(),
            "period": self.decision_period,
            "base": base,
            "obstacle_range": self.obstacle_range,
        }

    @property
    def judged(self) -> Dict[str, Any]:
        """Settings (DriveSettings) of the run's evaluations, without random choices."""
        settings = {name: getattr(self, name) for name in DriveSettings.model_fields}
        # What selects the policy is the better simulator, not the faster one of the actors.
        settings["simulator"] = "pybullet"
        if self.planner == DRAWN:
            settings["planner"] = OURS
        if self.protocol == DRAWN:
            settings["protocol"] = CHALLENGE
        return settings

    def noise(self, transitions: int) -> float:
        """Return the standard deviation of the exploration noise after a number of transitions."""
        steps = self.exploration_noise_steps
        if not steps:
            # The paper lowers the noise from .5 by .125 per million transitions, down to .02.
            papers = (0.5 - 0.02) / 0.125 * 1e6 * min(1.0, self.total_timesteps / PAPER_STEPS)
            steps = max(1, int(papers))
        share = min(1.0, transitions / steps)
        return (1.0 - share) * self.exploration_noise_initial + share * self.exploration_noise_final


def recipe(name: str) -> Dict[str, Any]:
    """Return the checked options of a recipe.

    Args:
        name: One of RECIPES, the path of a YAML file of options, or "" for none.

    Raises:
        ApplrError: The name or an option is unknown, or a value is invalid.
    """
    if not name:
        return {}
    if not name.endswith(".yaml") and name not in RECIPES:
        raise ApplrError(f"--recipe {name} is unknown: give {', '.join(RECIPES)} or a .yaml file")
    path = RECIPES.get(name, Path(name))
    values: Dict[str, Any] = read_yaml(path)
    checked(TrainConfig, values, str(path))
    return values


def parse(arguments: Optional[List[str]] = None) -> TrainConfig:
    """Return the configuration of a command line.

    With --resume, the command line overrides the stored options of the run.

    Args:
        arguments: Arguments without the program's name, None for sys.argv. ROS remappings
            (NAME:=VALUE) are ignored.

    Raises:
        ApplrError: An option is invalid.
    """
    explicit = command_line.given(TrainConfig, "./applr train", ABOUT, arguments)
    if explicit.get("resume"):
        return _resumed(explicit)
    config = checked(TrainConfig, {**recipe(explicit.get("recipe", "")), **explicit})
    # Without this error, an online run would begin, which takes days.
    if "gradient_steps" in config.model_fields_set and not config.dataset:
        raise ApplrError("--gradient-steps, also in a recipe, learns offline: give a --dataset")
    return config


def _resumed(explicit: Dict[str, Any]) -> TrainConfig:
    """Return the stored configuration of a run with the explicit options of the command line.

    Raises:
        ApplrError: There is no run, or an explicit option cannot be changed.
    """
    out = explicit.get("out", RunOptions().out)
    path = Path(out) / "config.json"
    if not path.exists():
        remedy = "check --out, or leave --resume out"
        raise ApplrError(f"--resume: {out} holds no run (no config.json): {remedy}")
    stored = {}
    with reading(path):
        for name, value in read_json(path).items():
            if name in TrainConfig.model_fields:  # Not the provenance
                stored[name] = value
    original = checked(TrainConfig, stored, str(path))
    config = checked(TrainConfig, {**stored, **explicit, "out": out})
    for name in FIXED:
        if getattr(config, name) != getattr(original, name):
            problem = f"{dashed(name)}: the run in {out} has another value, which cannot be changed"
            raise ApplrError(f"{problem}: omit it")
    return config
