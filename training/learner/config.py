"""The options of train.py: their groups in one class, the command line, recipes, and what a run stored.

Defaults are the paper's; where the paper is silent, those of its authors' code. Deviations are named in
training/td3/td3.py and docs/explanation/learning_problem.md.
"""

from __future__ import annotations

import math
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Dict, List, Literal, NamedTuple, Optional, Sequence

from pydantic import ConfigDict, Field, model_validator

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import read_json
from applr_ros1.common.yaml_files import read_yaml
from applr_ros1.policy import methods
from applr_ros1.policy.decision import PERIOD
from applr_ros1.policy.dimensionless import FORMS as POLICY_FORMS
from applr_ros1.policy.form import PAPER
from applr_ros1.robots import NAMES, load
from training.common.command_line import Monitor, Movers, Parser, Planner, Seed, SimulatorName, words
from training.common.options import Options, add_options, checked, dashed, option
from training.env import settings
from training.env.reward import RewardOptions
from training.td3.options import TD3Options
from worlds.loading import FORMS

RECIPES = Path(__file__).resolve().parents[1] / "recipes"
PROVENANCE = "provenance"  # in config.json, beside the options (training/common/provenance.py)
BASE = "base"  # in config.json, beside the options (Start.base)
POLICY_FILE = ".safetensors"  # how the name of a policy's file ends
PAPER_STEPS = 5_000_000
MOST_ROWS = 10**8  # of a replay buffer
Span = List[Annotated[float, Field(ge=0)]]  # one number, or the two between which each episode draws
SPANS = ("scan_noise", "latency", "slip", "friction", "ground", "odometry")  # fields of Randomisation


def span(default: float, help: str, more: str = "") -> Any:
    """Declares one of SPANS; help and more stand before and behind what two numbers mean."""
    text = f"{help} Two numbers: drawn between them at each reset{more}."
    return option([default], text, min_length=1, max_length=2)


class RunOptions(Options):
    """Folder and length of a run."""

    model_config = ConfigDict(title="The run")

    # fmt: off
    out: str = option("runs/applr",
        "Folder for the configuration, the checkpoints, all trajectories, the actors, and the learning curves.")
    resume: bool = option(False,
        "Continue the run in the folder --out with the options that it was started with. Options that are given again "
        "replace the stored ones, except for the networks, the replay buffer's size, the seed, the robot and "
        "--init-from.")
    total_timesteps: int = option(PAPER_STEPS,
        "Total number of transitions to collect, one per decision. The paper used 5 million.", ge=0, le=10**9)
    minutes: float = option(0.0,
        "Wall time [min] after which the run ends even before --total-timesteps, interruptions not counted. 0 sets no "
        "limit.", ge=0, le=1e6)
    seeds: int = option(1,
        "Number of trainings, one after the other, with the seeds from --seed on. They share --minutes, their best "
        "policies drive fresh courses, and the best of them is kept and compared with the robot's own parameters.",
        ge=1, le=100)
    # fmt: on


class ActorOptions(Options):
    """Collection of experience."""

    model_config = ConfigDict(title="Actors")

    # fmt: off
    actors: int = option(0,
        "Number of actors that drive episodes at the same time, as child processes. 0 drives one episode after the "
        "other in the learner's own process; the same seed then gives the same numbers in every run.", ge=0, le=10_000)
    ray_address: str = option("",
        "Run the actors on Ray: HOST:PORT of a cluster, or local to start Ray on this machine.")
    exploration_noise_initial: float = option(0.5,
        "Standard deviation of the exploration noise at the beginning, for actions from -1 to 1.", ge=0, le=2)
    exploration_noise_final: float = option(0.02,
        "Standard deviation of the exploration noise from --exploration-noise-steps transitions on.", ge=0, le=2)
    exploration_noise_steps: int = option(0,
        "Number of transitions over which the exploration noise goes from its initial to its final value. 0 takes the "
        "paper's 3.84 million, or proportionally fewer where --total-timesteps is below 5 million.", ge=0, le=10**9)
    # fmt: on


class TaskOptions(Options):
    """Worlds and robot."""

    model_config = ConfigDict(title="Worlds and robot")

    # fmt: off
    decision_period: float = option(PERIOD,
        "Simulated time [s] between two choices of the parameters. The paper used 2.", ge=0.05, le=10)
    robot: str = option("jackal",
        f"Robot that drives: {', '.join(NAMES)}, or a folder with robot.yaml (docs/tutorials/your_robot.md). The "
        "worlds are at its scale.", fixed=True)
    observation: Literal["paper", "dimensionless"] = option("paper",
        "What the policy sees and sets: paper, the capped scan, the direction of the local goal and the robot's own "
        "parameter space; or dimensionless, in the robot's size and speed (applr_ros1/policy/dimensionless.py).",
        fixed=True)
    worlds: str = option("generated:learn",
        f"Worlds to train in: {FORMS}; several are separated by commas. generated:learn are the training worlds "
        "without those of generated:validation.")
    simulator: SimulatorName = option("kinematic",
        "Simulator to train and evaluate in: kinematic or pybullet.")
    planner: Planner = option("ours",
        "Planner to train with: ours; cpp-like, which has the defects of the C++ move_base that success depends on; or "
        "drawn, which takes one of the two at each reset. Evaluations of a run with drawn use ours.")
    monitor: Monitor = option(False,
        "Drive with the collision monitor between the planner and the base, in training and in the evaluations.")
    movers: Movers = option(False,
        "Track what moves in the scans and mark where it will be in the costmaps, in training and in the evaluations.")
    end_on_collision: bool = option(False,
        "End a training episode at the first collision, as a failure. Evaluations are not ended.")
    end_on_stall: bool = option(False,
        "End a training episode, as a failure, when the robot has come less than .85 m in 8 s, at the Jackal's scale. "
        "Evaluations are not ended.")
    protocol: Literal["paper", "barn-challenge", "drawn"] = option("paper",
        "Course of the worlds in training and evaluation: paper, barn-challenge (10 m straight through, and in "
        "evaluations a collision ends the trial), or drawn, which takes one of the two in each episode, and "
        "barn-challenge in evaluations.")
    critics_know_more: bool = option(False,
        "Show the critics what the policy cannot know: the true course ahead, moving obstacles, planner, ground, "
        "friction and delays (training/env/privileged.py).", fixed=True)
    start_xy: float = option(0.0,
        "Largest random displacement [m] of the start position along x and along y.", ge=0, le=10)
    start_yaw: float = option(0.0, "Largest random rotation [rad] of the start heading.", ge=0, le=math.pi)
    scan_noise: Span = span(1.0, "Factor on the standard deviation of the laser's noise.")
    latency: Span = span(0.0, "Delay [s] of the velocity commands.")
    slip: Span = span(1.0, "Factor on the slip and drift of the base.")
    friction: Span = span(1.0, "Factor on the wheels' friction.")
    ground: Span = span(1.0, "Share of the robot's own ground, 1 or more all of it; the rest is plain.",
        ", so that 0 2 gives half of the episodes the robot's own ground and the others one in between")
    odometry: Span = span(1.0, "Factor on the odometry's errors.")
    # fmt: on


class LearnerOptions(TD3Options):
    """Size of the memory, times of gradient steps, and TD3's own options."""

    model_config = ConfigDict(title="Learner")

    # fmt: off
    seed: Seed = option(0,
        "Seed of every random draw: network initialisation, exploration noise, batches, worlds and simulators.",
        fixed=True)
    device: str = option("auto",
        "Device that the learner computes on: cpu, cuda, or auto for the GPU where there is one.")
    utd_ratio: float = option(0.1, "Number of gradient steps per collected transition.", ge=0, le=100)
    mirror: bool = option(False,
        "Mirror half of each batch left to right (scan and local goal), which doubles the experience: robot, planner "
        "and parameters are symmetric.")
    learning_starts: int = option(0,
        "Number of transitions with uniformly random actions before the first gradient step. The paper has none. With "
        "--init-from they are driven by the policy with exploration noise.", ge=0, le=10**9)
    buffer_size: int = option(0,
        "Number of rows of the replay buffer; an episode takes one more row than it has transitions. 0 holds all "
        "transitions of --total-timesteps and a tenth more.", fixed=True, ge=0, le=MOST_ROWS)
    # fmt: on


class Start(NamedTuple):
    """Start of a run: one of the first three, or random weights."""

    run: str = ""  # folder of another run, whose networks and optimisers are taken over
    policy: str = ""  # file of a policy in the dimensionless form
    action: Sequence[float] = ()  # the policy's first answer to any observation
    base: Dict[str, float] = {}  # values of the parameters that a policy in the dimensionless form does not choose


class OfflineOptions(Options):
    """Learning without driving."""

    model_config = ConfigDict(title="Offline learning, and what a run begins with")

    # fmt: off
    dataset: str = option("",
        "Folder to learn from offline: a dataset that bags_to_dataset.py wrote. Without it the run is "
        "online.")
    gradient_steps: int = option(100_000, "Number of gradient steps of offline learning.", ge=0, le=10**9)
    init_from: str = option("",
        "Start from the policy, critics and optimisers of another run, given by its folder, without its experience "
        "(period, reward and worlds may differ); or from a parameter set as the policy's first output, static for the "
        "robot's own best single set, dwa for its default parameters or a JSON file, which also gives the parameters "
        "that a policy in the dimensionless form does not choose; or from the file of a policy in the dimensionless "
        "form, which stands still while the critics learn alone for 2,000 gradient steps. "
        "Default: the policy's first output is near the middle of the ranges.",
        fixed=True)
    # fmt: on


class PeriodicOptions(Options):
    """Times and worlds of the policy's evaluation."""

    model_config = ConfigDict(title="Periodic evaluation")

    # fmt: off
    eval_worlds: str = option("generated:validation",
        "Held-out worlds in which the policy is evaluated during the run, to choose the best actor. The default is a "
        "part of the training worlds that --worlds leaves out, so that no test world affects the choice. none disables "
        "the evaluation.")
    eval_freq: int = option(50_000,
        "Number of transitions (offline: of gradient steps) between two evaluations.", ge=1, le=10**9)
    n_eval_episodes: int = option(1, "Number of trials in each held-out world.", ge=1, le=1000)
    # fmt: on


class TrainConfig(
    RunOptions, ActorOptions, TaskOptions, RewardOptions, LearnerOptions, OfflineOptions, PeriodicOptions
):
    """The options of a run, checked, and what its parts need of them."""

    model_config = ConfigDict(title=None)

    @model_validator(mode="after")
    def _check(self) -> "TrainConfig":
        load(self.robot, report=True)
        for name in SPANS:
            if getattr(self, name) != sorted(getattr(self, name)):
                raise ApplrError(f"{dashed(name)} is {getattr(self, name)}: give the smaller number first")
        return self

    # -- what the parts need
    @cached_property
    def start(self) -> Start:
        """Return what --init-from names. Raises ApplrError for what is of no use.

        A run that has saved a checkpoint goes on from that and does not read it again.
        """
        name, out, begun = self.init_from, Path(self.out), {}
        if self.resume and (out / "config.json").exists():
            begun = read_json(out / "config.json").get(BASE, {})
        if not name or self.resume and (out / "checkpoint.json").exists():
            return Start(base=begun)
        if name.endswith(POLICY_FILE):
            if self.observation == PAPER:
                raise ApplrError(f"--init-from is {self.init_from!r}: a policy needs --observation dimensionless")
            return Start(policy=name)
        if (Path(name) / "checkpoint.json").exists():
            return Start(run=name)
        robot = load(self.robot)
        is_method = name in methods.METHODS or name.endswith(".json")
        method = methods.make(name, robot) if is_method else None
        if not isinstance(method, methods.FixedParameters):
            raise ApplrError(
                f"--init-from is {self.init_from!r}: give static, dwa, a JSON file with a parameter set, the file of "
                "a policy, or the folder of a training run that has saved a checkpoint"
            )
        form = POLICY_FORMS[self.observation](robot, self.decision_period)
        base = {name: value for name, value in form.space.as_dict(method.values).items() if name not in form.chosen}
        return Start(action=form.action(method.values).tolist(), base=base if self.observation != PAPER else {})

    def resolved(self) -> "TrainConfig":
        """With what depends on --total-timesteps written out, so that a resumed run's longer one does not change it."""
        steps, papers = self.total_timesteps, (0.5 - 0.02) / 0.125 * 1e6
        noise = max(1, int(papers * min(1.0, steps / PAPER_STEPS)))
        return self.model_copy(
            update={
                "buffer_size": self.buffer_size or min(MOST_ROWS, max(1000, int(1.1 * steps) + 1000)),
                "exploration_noise_steps": self.exploration_noise_steps or noise,
            }
        )

    def reward(self) -> Dict[str, Any]:
        """Fields of the Reward."""
        return {name: getattr(self, name) for name in RewardOptions.model_fields}

    def randomisation(self) -> Dict[str, Any]:
        """Fields of the simulators' Randomisation."""
        spans = {name: getattr(self, name) for name in SPANS}
        drawn = {name: span if len(span) == 2 else span[0] for name, span in spans.items()}
        return dict(start_xy=self.start_xy, start_yaw=self.start_yaw, **drawn)

    @property
    def eval_planner(self) -> str:
        """The planner of the evaluations."""
        return "ours" if self.planner == "drawn" else self.planner

    @property
    def eval_protocol(self) -> str:
        """The rules of the evaluations."""
        return settings.CHALLENGE if self.protocol == settings.DRAWN else self.protocol

    def setting(self) -> str:
        """Return the setting of the periodic evaluation in words: results of another setting cannot be compared."""
        beside = ["collision monitor"] * self.monitor + ["movers"] * self.movers
        rules = [self.eval_protocol] * (self.eval_protocol != settings.PAPER)
        return ", ".join([self.eval_worlds, self.simulator, self.eval_planner, *beside, *rules])

    def noise(self, transitions: int) -> float:
        """Exploration noise after so many transitions (of a resolved configuration)."""
        share = min(1.0, transitions / self.exploration_noise_steps)
        return (1.0 - share) * self.exploration_noise_initial + share * self.exploration_noise_final


def recipes() -> List[str]:
    """Names of the recipes that come with the package (training/recipes/NAME.yaml)."""
    return sorted(path.stem for path in RECIPES.glob("*.yaml"))


def recipe(name: str) -> Dict[str, Any]:
    """The options of a recipe, checked.

    Args:
        name: one of recipes(), the path of a YAML file of options, or "" for none.

    Raises:
        ApplrError: with one line, for an unknown name or a file that holds anything but options.
    """
    if not name:
        return {}
    if not name.endswith(".yaml") and name not in recipes():
        raise ApplrError(f"--recipe {name} is unknown: give {', '.join(recipes())} or a .yaml file")
    path = Path(name) if name.endswith(".yaml") else RECIPES / (name + ".yaml")
    values = read_yaml(path)
    if not isinstance(values, dict):
        raise ApplrError(f"{path}: holds no options; give lines such as `batch_size: 256`")
    return checked(TrainConfig, values, str(path)).model_dump(include=set(values))


def parser() -> Parser:
    """The command line."""
    made = Parser(
        "train.py",
        "Trains a policy that sets the planner's parameters, with TD3: online with actors that drive in\nsimulation, "
        "or offline from a --dataset. Ctrl-C saves the run and stops; --resume continues it.",
        "Defaults are the paper's; where the paper is silent, those of its authors' code.\n"
        "docs/explanation/learning_problem.md describes the learning problem and each deviation.",
    )
    made.add_argument(
        "--recipe",
        default="",
        help="Use the options of a recipe: one of %s, or a YAML file of options. Options given beside it replace those "
        "of the recipe." % ", ".join(recipes()),
    )
    add_options(made, TrainConfig)
    return made


def parse(arguments: Optional[List[str]] = None) -> TrainConfig:
    """The configuration that a command line asks for; with --resume the options that the run was begun with.

    Args:
        arguments: without the program's name; None: those of this process. ROS's remappings (name:=value) are ignored.

    Raises:
        ApplrError: with one line.
    """
    given = vars(parser().parse_args(words(arguments)))
    of_recipe = recipe(given.pop("recipe"))
    if not given.get("resume"):
        config = checked(TrainConfig, {**of_recipe, **given})
        if "gradient_steps" in config.model_fields_set and not config.dataset:  # else it drove for days
            raise ApplrError("--gradient-steps, or a recipe with them, learns offline: give a --dataset")
        return config
    out = given.get("out", RunOptions().out)  # a resumed run keeps its options, whatever the recipe says
    path = Path(out) / "config.json"
    if not path.exists():
        raise ApplrError(f"--resume: {out} holds no run (no config.json); check --out, or leave --resume out")
    stored = read_json(path)
    for name in (PROVENANCE, BASE):
        stored.pop(name, None)
    begun = checked(TrainConfig, stored, str(path))
    config = checked(TrainConfig, {**stored, **given, "out": out})
    for name, field in TrainConfig.model_fields.items():
        if field.json_schema_extra["fixed"] and getattr(config, name) != getattr(begun, name):  # type: ignore[index,call-overload]
            raise ApplrError(
                f"{dashed(name)} {getattr(config, name)}: the run in {out} was begun with {getattr(begun, name)}, "
                "which cannot be changed"
            )
    return config
