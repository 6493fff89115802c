"""Tests of the options of a training run: refusals before its folder is made, recipes, options of a
resumed run.
"""

import json

import pytest

from applr_ros1.common.errors import ApplrError
from applr_ros1.policy.actor import save
from applr_ros1.policy.dimensionless import DimensionlessEncoding
from applr_ros1.robots import JACKAL
from sim_bridge.simulator import Randomisation
from tests.support.robots import make_weights
from tests.support.runs import NO_EVALUATION, one_line, toy
from training.train import __main__ as train
from training.train.learner.config import TrainConfig, parse
from training.train.td3.td3 import ACTOR_LR, CRITIC_WARM_UP, TAU


@pytest.mark.fault("23a")
@pytest.mark.parametrize(
    ("arguments", "pattern"),
    [
        (["--learning-rate", "1"], "unrecognized arguments: --learning-rate 1; --help"),
        (
            ["--net-arch", "512", "0"],
            "--net-arch is '0': give at least 1",
        ),
        (["--worlds", "generated:900"], "generated:900"),
        (["--latency", "0.2", "0.1"], r"latency = \[0.2, 0.1\]: give a number >= 0 or a range"),
        (["--dataset", "/nowhere"], "/nowhere: no dataset there"),
        (["--resume", "--out", "/nowhere/at/all"], "holds no run"),
        (["--recipe", "offline"], "learns offline: give a --dataset"),
        (["--recipe", "nothing"], "--recipe nothing is unknown: give jackal, offline, paper"),
        (
            ["--recipe", "jackal", "--robot", "turtlebot3_burger", *NO_EVALUATION],
            "static: there is no .*/static.json: choose the method dwa, or run `./applr tune ",
        ),
        (["--init-from", "nope.safetensors", *NO_EVALUATION], "nope.safetensors: cannot be read"),
        (["--init-from", "nope", *NO_EVALUATION], "--init-from is 'nope': give static, dwa, "),
    ],
)
def test_bad_options_are_one_line_and_leave_no_folder(arguments, pattern, tmp_path, capsys):
    one_line(capsys, toy(tmp_path / "run", *arguments), pattern, train.main)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("seeds", [[], ["--seeds", "2"]], ids=["one seed", "two seeds"])
def test_a_start_that_is_refused_leaves_the_folder_as_it_is(tmp_path, capsys, seeds):
    (tmp_path / "notes.txt").write_text("mine")
    refused_start = toy(tmp_path, *seeds, "--init-from", "nope.safetensors", *NO_EVALUATION)
    # The same command says the same again, not that there is a run already.
    for _ in range(2):
        one_line(capsys, refused_start, "nope.safetensors: cannot be read", train.main)
    assert not [path for path in tmp_path.iterdir() if path.is_dir()]
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_a_file_of_options_has_the_names_of_the_command_line(tmp_path):
    # Options of the command line take precedence over the file.
    recipe_file = tmp_path / "own.yaml"
    recipe_file.write_text("batch_size: 64\ndecision_period: 1.0\nslip: [0.7, 1.4]\n")
    config = parse(["--recipe", str(recipe_file), "--decision-period", "0.5"])
    assert (config.batch_size, config.decision_period, config.slip) == (64, 0.5, [0.7, 1.4])
    for content, pattern in (
        ("batchsize: 64\n", "own.yaml: unknown option 'batchsize'"),
        ("gamma: fast\n", "own.yaml: gamma is 'fast': give a number"),
        ("- 3\n", "own.yaml: give lines such as name: value"),
        ("a: [\n", "cannot be read"),
    ):
        recipe_file.write_text(content)
        with pytest.raises(ApplrError, match=pattern):
            parse(["--recipe", str(recipe_file)])


@pytest.mark.parametrize("name", ["paper", "jackal", "offline"])
def test_each_recipe_consists_of_valid_options(name):
    dataset = ["--dataset", "drives"] if name == "offline" else []
    assert parse(["--recipe", name, *dataset, "--seed", "7"]).seed == 7


def test_defaults_and_noise_are_the_documented_ones():
    paper = TrainConfig()
    assert paper.gamma == 0.95
    assert paper.critic_lr == 1e-3
    assert ACTOR_LR == 3e-4
    assert TAU == 0.005
    assert CRITIC_WARM_UP == 2000

    # The noise falls over 3.84 of the paper's 5 million steps, and over that share of other runs.
    assert paper.noise(0) == 0.5
    assert paper.noise(1_000_000) == pytest.approx(0.375)
    assert paper.noise(3_840_000) == pytest.approx(0.02)
    assert paper.noise(5_000_000) == 0.02
    assert TrainConfig(total_timesteps=50_000).noise(38_400) == pytest.approx(0.02)
    rising = TrainConfig(
        exploration_noise_initial=0.0, exploration_noise_final=0.1, exploration_noise_steps=100
    )
    assert rising.noise(0) == 0.0
    assert rising.noise(50) == pytest.approx(0.05)
    assert rising.noise(400) == pytest.approx(0.1)


def test_without_options_nothing_differs_between_episodes():
    randomisation = TrainConfig().environment()["randomisation"]
    assert Randomisation(**randomisation) == Randomisation()


def test_a_run_starts_at_a_parameter_set(tmp_path):
    # min_in_place_vel_theta is no parameter of the policy: it is set once, before the drives.
    set_file = tmp_path / "set.json"
    set_file.write_text('{"max_vel_x": 1.0, "min_in_place_vel_theta": 0.7}')
    for set_name in (str(set_file), "dwa"):
        action, fixed_values = parse(["--init-from", set_name]).start
        assert len(action) == 8
        assert fixed_values == {}

    options = ["--init-from", str(set_file), "--observation", "dimensionless"]
    action, fixed_values = parse(options).start
    assert len(action) == 12
    assert fixed_values == {
        "min_in_place_vel_theta": 0.7,
        "footprint_padding": 0.1,
        "escape_reset_dist": 0.1,
        "escape_reset_theta": 0.1,
        "min_vel_x": 0.1,
    }


def test_a_run_learns_with_the_obstacle_range_of_the_set_or_policy_at_its_start(tmp_path):
    set_file = tmp_path / "set.json"
    set_file.write_text('{"obstacle_range": 5.0, "parameters": {}}')
    run_folder = tmp_path / "run"
    run_folder.mkdir()
    save(run_folder / "actor.safetensors", make_weights(), {"obstacle_range": 4.0})
    for start, expected in ((set_file, 5.0), (run_folder, 4.0), ("dwa", None), ("", None)):
        config = parse(["--init-from", str(start)])
        assert config.environment()["obstacle_range"] == expected


def test_a_resumed_run_goes_on_with_what_its_own_policy_says(tmp_path):
    # Given: a run whose parameter set is gone
    set_file = tmp_path / "set.json"
    stored = {"out": str(tmp_path), "init_from": str(set_file), "observation": "dimensionless"}
    (tmp_path / "config.json").write_text(json.dumps(stored))
    encoding = DimensionlessEncoding(JACKAL, 2.0, {"min_in_place_vel_theta": 0.7})
    weights = make_weights(inputs=encoding.size, outputs=encoding.actions)
    resume = ["--resume", "--out", str(tmp_path)]
    # Then: the values and the range with which it has learned count, also if it has no range
    for metadata, expected in (({"obstacle_range": 4.0}, 4.0), ({}, None)):
        save(tmp_path / "actor.safetensors", weights, metadata, encoding)
        environment = parse(resume).environment()
        assert environment["base"] == {"min_in_place_vel_theta": 0.7}
        assert environment["obstacle_range"] == expected
        # Also if the set has changed
        set_file.write_text('{"obstacle_range": 6, "parameters": {"min_in_place_vel_theta": 0.5}}')
    # A run that was stopped before it wrote a policy begins with its start.
    (tmp_path / "actor.safetensors").unlink()
    assert parse(resume).obstacle_range == 6.0


@pytest.mark.parametrize("is_folder", [False, True])
def test_a_run_that_takes_over_a_policy_drives_with_its_other_values(tmp_path, is_folder):
    encoding = DimensionlessEncoding(JACKAL, 1.0, {"min_in_place_vel_theta": 0.7})
    start = tmp_path / "start"
    start.mkdir()
    weights = make_weights(inputs=encoding.size, outputs=encoding.actions)
    policy_file = start / "actor.safetensors"
    save(policy_file, weights, {"obstacle_range": 4.0}, encoding)
    init_from = str(start if is_folder else policy_file)
    config = parse(["--init-from", init_from, "--observation", "dimensionless"])
    environment = config.environment()
    assert environment["base"] == {"min_in_place_vel_theta": 0.7}
    assert environment["obstacle_range"] == 4.0


@pytest.mark.parametrize(
    "option",
    [
        "--recipe jackal",
        "--net-arch 64",
        # The problem whose rewards it has stored
        "--decision-period 0.5",
        "--failure-seconds 0.5",
        # The conditions of its evaluations
        "--matched",
    ],
)
def test_a_resumed_run_keeps_its_stored_options(option, tmp_path):
    stored = {"out": str(tmp_path), "recipe": "paper", "monitor": True, "matched": False}
    (tmp_path / "config.json").write_text(json.dumps(stored))
    resume = ["--resume", "--out", str(tmp_path)]
    config = parse([*resume, "--recipe", "paper"])
    assert not config.along_y
    assert not config.matched
    name, *values = option.split()
    with pytest.raises(ApplrError, match=f"{name}: the run in .* cannot be changed"):
        parse([*resume, name, *values])
