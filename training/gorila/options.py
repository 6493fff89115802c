"""Every option of train.py, once: name, type, default and sentence, in the groups of the command line's help.

config.py adds the checks and the command line. Defaults are the paper's; where the paper is silent, those of its
authors' code. Deviations are named in training/td3/td3.py and docs/training.md.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from applr_ros1.planner.variant import DEFAULT_WEIGHTS, DRAWN, OURS, PLANNERS, WEIGHTS
from applr_ros1.policy.decision import PERIOD
from applr_ros1.robots import NAMES
from training.gorila.learner import LearnerConfig
from training.mdp.reward import Reward
from training.mdp.rollout import NAVIGATION
from training.td3.td3 import TD3Config
from training.workers.pool import KINDS
from worlds.loading import FORMS

PAPER_STEPS = 5_000_000


def option(default, doc: str, choices=None, group: str = ""):
    """Declare a field of Options.

    Args:
        default: its default; None is not used.
        doc: its help text, whole sentences that stand by themselves.
        choices: the values that it can have, None for any.
        group: title of the group of options that begins with this one; "" stays in the group before.
    """
    return field(default=default, metadata={"doc": doc, "choices": choices, "group": group})


@dataclass(frozen=True)
class Options:
    """The options of a run as given or stored."""

    # fmt: off

    out: str = option("runs/applr",
        "Folder of the run. It takes the configuration, the checkpoints, the journal of all trajectories, the actors, "
        "and the learning curves.", group="The run")
    resume: bool = option(False,
        "Continue the run in the folder --out with the options that it was started with. Options that are given again "
        "replace the stored ones, except for the networks, what the critics' outputs mean, the replay buffer's size, "
        "the seed, the environment, the robot and --start.")
    steps: int = option(PAPER_STEPS,
        "Number of transitions to collect in all, one per decision. The paper used 5 million.")
    minutes: float = option(0.0,
        "Wall time [min] after which the run ends even before --steps, interruptions not counted. 0 sets no limit. "
        "What --partner and --refine do afterwards is not part of it.")
    seed: int = option(0,
        "Seed of every random draw: network initialisation, exploration noise, batches, worlds and simulators.")
    device: str = option("auto",
        "Device that the learner computes on: cpu, cuda, or auto for the GPU where there is one.")
    threads: int = option(0,
        "Number of CPU threads of the learner. 0 takes the cores that the actors leave, and at least one.")

    actors: int = option(0,
        "Number of actors that drive episodes at the same time. 0 drives one episode after the other in the learner's "
        "own process; the same seed then gives the same numbers in every run.", group="Actors")
    pool: str = option("ray",
        "How the actors run: as Ray actors, or as child processes of the learner.", choices=KINDS)
    ray_address: str = option("",
        "Address HOST:PORT of a Ray cluster to run the actors on. Without it Ray is started on this machine.")
    publish_every: int = option(25, "Number of gradient steps after which the actors get the newest policy.")
    max_staleness: int = option(0,
        "Largest age, in gradient steps, of the policy that drove an episode; older episodes are refused. 0 accepts "
        "all episodes and only reports the policies' age.")

    period: float = option(PERIOD,
        "Decision period [s]: simulated time between two choices of the parameters. The paper used 2.",
        group="Worlds and robot")
    env: str = option(NAVIGATION,
        "Training environment as MODULE:CLASS. An environment other than the default is constructed without arguments.")
    robot: str = option("jackal",
        "Robot that drives: %s, or a folder with robot.yaml (docs/robots.md). The worlds are at its scale." % (
            ", ".join(NAMES)))
    worlds: str = option("generated:learn",
        "Worlds to train in: %s; several are separated by commas. generated:learn are the training worlds without "
        "those of generated:validation." % FORMS)
    simulator: str = option("kinematic",
        "Simulator to train in: kinematic, pybullet, or the MODULE:CLASS of your own.")
    weights: str = option(DEFAULT_WEIGHTS,
        "What the planner's distance weights (path and goal distance bias) count during training: cells (per_cell), "
        "metres (per_metre), or drawn, which takes one of the two at each reset.", choices=WEIGHTS + (DRAWN,))
    planner: str = option(OURS,
        "Planner to train with: ours; cpp-like, which has the defects of the C++ move_base that success depends on; or "
        "drawn, which takes one of the two at each reset.", choices=PLANNERS + (DRAWN,))
    planner_frequency: int = option(0,
        "Global plans per simulated second during training. 10 or 5 make the simulation faster and less exact. "
        "0 plans as often as the robot does, as evaluations always do; the Jackal plans 20 times.")
    monitor: bool = option(False,
        "Drive with the collision monitor between the planner and the base, in training and in the evaluations.")
    curriculum: float = option(0.0,
        "Share of --steps over which the harder worlds are added to the easiest quarter. 0 uses all worlds from the "
        "beginning.")
    start_xy: float = option(0.0, "Largest random displacement [m] of the start position along x and along y.")
    start_yaw: float = option(0.0, "Largest random rotation [rad] of the start heading.")
    scan_noise: str = option("1",
        "Factor on the standard deviation of the laser's noise. LOW,HIGH draws the factor anew at each reset.")
    latency: str = option("0", "Delay [s] of the velocity commands. LOW,HIGH draws it anew at each reset.")
    friction: str = option("1", "Factor on the friction of the wheels. LOW,HIGH draws it anew at each reset.")
    slip: str = option("1", "Factor on the slip and drift of the base. LOW,HIGH draws it anew at each reset.")

    c_f: float = option(Reward.c_f,
        "Coefficient of the time term: what each 2 s before the goal cost.",
        group="Reward (docs/training.md, training/mdp/reward.py)")
    c_p: float = option(Reward.c_p,
        "Coefficient of the progress term: what each metre of progress towards the goal earns.")
    c_c: float = option(Reward.c_c,
        "Coefficient of the clearance term: what 1/d costs in 2 s, with d the distance [m] of the nearest obstacle in "
        "the laser scan.")
    end_on_contact: bool = option(False,
        "End a training episode at the first contact, as a failure. Evaluations are not ended.")
    along_y: bool = option(False,
        "Measure progress along the y axis of the world, as the paper simplified it, instead of in the direction of "
        "the goal.")
    exact_time: bool = option(False,
        "Count the time term in seconds, including the fraction of the last decision, instead of in whole decisions.")
    lowest: bool = option(False,
        "Take d of the clearance term from all scans of a decision period instead of from its last scan.")
    c_contact: float = option(0.0, "Cost of a decision period in which the robot touched something.")
    c_switch: float = option(0.0,
        "Cost of changing the parameters: factor on their mean absolute change, each scaled to [-1, 1].")
    c_jerk: float = option(0.0, "Cost of a mean jerk of 10 m/s^3 during 2 s.")

    hidden: str = option("512,512,512", "Sizes of the hidden layers of the policy and of both critics.", group="TD3")
    actor_lr: float = option(TD3Config.actor_lr, "Learning rate of the policy.")
    critic_lr: float = option(TD3Config.critic_lr, "Learning rate of the critics.")
    gamma: float = option(TD3Config.gamma, "Discount factor per decision.")
    n_step: int = option(TD3Config.n_step, "Number of decisions in an n-step return.")
    batch_size: int = option(TD3Config.batch_size, "Number of transitions in the batch of a gradient step.")
    tau: float = option(TD3Config.tau,
        "Share of the current networks that enters the target networks at each policy step.")
    target_noise: float = option(TD3Config.target_noise,
        "Standard deviation of the smoothing noise on target actions, which range from -1 to 1.")
    noise_clip: float = option(TD3Config.noise_clip, "Largest absolute value of the smoothing noise on target actions.")
    saturation: float = option(TD3Config.saturation,
        "Weight of a penalty on the mean square of the policy's outputs before tanh. It keeps them away from the ends "
        "of the ranges, where tanh has no gradient. 0 switches it off.")
    average: float = option(TD3Config.average,
        "Decay per policy step of a running average of the policy, such as 0.999; actors and actor files then hold the "
        "average. 0 uses the policy itself.")
    symmetric: bool = option(TD3Config.symmetric,
        "Hand the mean of the policy and of its mirror image out to actors and actor files, which is as symmetric as "
        "robot and planner are. The policy alone is so only as far as it has learnt it.")
    scan_pool: int = option(TD3Config.scan_pool,
        "Number of neighbouring beams whose mean is one input of the networks. 5 turns 720 beams into 144 inputs and "
        "makes a gradient step four times faster; the actor file still takes every beam.")
    layer_norm: bool = option(TD3Config.layer_norm,
        "Normalise the hidden layers of the critics, which keeps many gradient steps per transition stable.")
    bins: int = option(TD3Config.bins,
        "Number of intervals of values that the critics tell apart as classes, such as 101, instead of regressing the "
        "value: rare returns far off the others then disturb them less. 0 regresses.")
    value_low: float = option(TD3Config.value_low,
        "Lower end of the range of values that --bins divides. Lower target values count as this.")
    value_high: float = option(TD3Config.value_high,
        "Upper end of the range of values that --bins divides. Higher target values count as this.")
    bf16: bool = option(TD3Config.bf16,
        "Compute the products of the networks' hidden layers in bfloat16 instead of float32. On processors that know "
        "bfloat16 (AVX512-BF16, AMX) and on GPUs a gradient step is then faster, on others slower.")
    critics: int = option(TD3Config.critics,
        "Number of critics. The paper's two, or up to as many as the policy has outputs: each target value is then the "
        "lower of two that are drawn anew, and the policy climbs the mean of all, which is less noisy.")
    policy_delay: int = option(TD3Config.policy_delay, "Number of critic updates per policy update.")
    updates_per_transition: float = option(LearnerConfig.updates_per_transition,
        "Number of gradient steps per collected transition.")
    mirror: bool = option(False,
        "Mirror half of each batch left to right (scan and local goal), which doubles the experience: robot, planner "
        "and parameters are symmetric. It is for the default --env only.")
    warmup: int = option(0,
        "Number of transitions with uniformly random actions before the first gradient step. The paper has none. With "
        "--start they are driven by the policy with exploration noise.")
    start: str = option("",
        "What learning begins with: the folder of another run, whose policy, critics and optimisers are taken over "
        "without its experience (period, reward and worlds may be others); or a parameter set that the policy first "
        "answers with, static for the robot's own best single set or a JSON file. Without it the policy begins near "
        "the middle of the ranges.")
    capacity: int = option(0,
        "Number of rows of the replay buffer; an episode takes one more row than it has transitions. 0 holds all "
        "transitions of --steps and a tenth more.")
    noise_start: float = option(0.5,
        "Standard deviation of the exploration noise at the beginning, for actions from -1 to 1.")
    noise_end: float = option(0.02, "Standard deviation of the exploration noise from --noise-steps transitions on.")
    noise_mixed: bool = option(False,
        "Draw the standard deviation of the exploration noise anew in each episode, from 0 to twice that of "
        "--noise-start and --noise-end.")
    noise_held: float = option(0.0,
        "Share of the exploration noise's variance, 0 to 1, that is drawn once an episode and held, instead of anew in "
        "each decision.")
    noise_steps: int = option(0,
        "Number of transitions over which the exploration noise goes from --noise-start to --noise-end. 0 takes the "
        "paper's 3.84 million, or proportionally fewer where --steps is below 5 million.")

    dataset: str = option("",
        "Folder of a dataset to learn from offline (written by bags_to_dataset.py or training.dataset). "
        "Without it the run is online.", group="Offline learning")
    mix: bool = option(False,
        "Load --dataset into the replay buffer, make the gradient steps that are due for it, and then train online. "
        "--steps, warm-up, noise and curriculum count what is collected, not the dataset.")
    updates: int = option(100_000, "Number of gradient steps of offline learning.")
    bc_alpha: float = option(0.0,
        "Alpha of TD3+BC, which keeps the policy close to the actions of the dataset; its paper uses 2.5. Online it "
        "keeps it close to what it has driven with. 0 is plain TD3.")

    checkpoint_every: float = option(120.0,
        "Seconds between two checkpoints.", group="Checkpoints and periodic evaluation")
    eval_worlds: str = option("generated:validation",
        "Held-out worlds in which the policy is evaluated during the run, which chooses the best actor. The default is "
        "a part of the training worlds that --worlds leaves out, so that no test world takes part in the choice. none "
        "switches the evaluation off.")
    eval_count: int = option(0, "Number of the held-out worlds that are used, evenly spread over them. 0 uses all.")
    eval_trials: int = option(1, "Number of trials in each held-out world.")
    eval_every: int = option(50_000, "Number of transitions (offline: of gradient steps) between two evaluations.")
    eval_simulator: str = option("",
        "Simulator of the evaluations: kinematic, pybullet, or the MODULE:CLASS of your own. Without it they use that "
        "of the training.")
    eval_weights: str = option("",
        "What the planner's distance weights count in the evaluations: per_cell, per_metre, or drawn by world and "
        "trial. Without it they count the same as in the training.", choices=("",) + WEIGHTS + (DRAWN,))
    eval_planner: str = option("",
        "Planner of the evaluations: ours, cpp-like, or drawn by world and trial. Without it they use the one of the "
        "training.", choices=("",) + PLANNERS + (DRAWN,))
    contact_seconds: float = option(5.0,
        "Time [s] that a trial with a contact is charged in addition when the best actor is chosen.")
    tensorboard: bool = option(True, "Write TensorBoard event files into the run's folder.")

    partner: str = option("",
        "Recipe, or YAML file of options, with which a second policy is trained after the first one, in the folder "
        "partner below --out. Robot, actors, device and --symmetric are those of this run, the seed is the next one. "
        "The mean of the two policies is mean.safetensors. Two policies that were learnt in different ways have "
        "different faults, and their mean often has less of them. Without it there is one policy.",
        group="After the training")
    refine: int = option(0,
        "Number of steps in which the last policy, or the mean with --partner, is refined after the training, as "
        "training.refine_policy does it: each drives 500 fresh worlds twice, and the result is refined.safetensors in "
        "the folder of the run. The simulator, weights and planner are those of the evaluations. 0 does not refine.")
    # fmt: on
