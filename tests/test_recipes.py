"""Recipes: named sets of training options (training/recipes/)."""

import pytest

from training.gorila import config as options


def test_recipes_are_options_that_the_command_line_replaces(tmp_path):
    chosen = options.parse(["--recipe", "paper", "--seed", "7"])
    assert (chosen.period, chosen.steps, chosen.hidden, chosen.seed) == (2.0, 5_000_000, "512,512,512", 7)
    assert (chosen.n_step, chosen.along_y, chosen.worlds) == (1, True, "generated:train")
    shipped = options.parse(["--recipe", "applr"])
    assert (shipped.period, shipped.simulator, shipped.weights, shipped.planner) == (
        1.0,
        "pybullet",
        "per_cell",
        "drawn",
    )
    assert (shipped.symmetric, shipped.c_switch, shipped.eval_worlds) == (True, 3.0, "fresh:20000-20199")
    assert all(options.parse(["--recipe", name]) for name in options.recipes())
    own = tmp_path / "own.yaml"
    own.write_text("batch_size: 64\nperiod: 1.0\n")
    assert options.parse(["--recipe", str(own), "--period", "0.5"]).period == 0.5
    own.write_text("batchsize: 64\n")
    with pytest.raises(options.ConfigError, match="unknown option 'batchsize'"):
        options.parse(["--recipe", str(own)])
    with pytest.raises(options.ConfigError, match="paper"):
        options.parse(["--recipe", "nothing"])
