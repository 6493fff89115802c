"""The method static: a set for each kind of distance weights, chosen by what a trial is driven with."""

import pytest

from applr_ros1.planner.variant import DRAWN, PER_CELL, PER_METRE
from applr_ros1.policy import methods
from training.evaluation import run as evaluation
from training.evaluation.trials import TrialRunner
from training.workers.tasks import Trial


def test_each_kind_of_weights_has_its_set():
    sets = {kind: methods.make(methods.for_weights("static", kind)) for kind in (PER_CELL, PER_METRE)}
    assert {kind: method.weights for kind, method in sets.items()} == {PER_CELL: PER_CELL, PER_METRE: PER_METRE}
    assert (sets[PER_CELL].values != sets[PER_METRE].values).any()
    assert methods.for_weights("static", DRAWN) == "static"
    assert methods.for_weights("dwa", PER_METRE) == "dwa"
    for form in ("frozen:vx_samples:%s", "period:1:%s", "frozen:vx_samples:period:.5:%s"):
        assert methods.for_weights(form % "static", PER_METRE) == form % "static_per_metre"
        assert methods.for_weights(form % "applr", PER_METRE) == form % "applr"


def test_a_training_begins_with_the_set_of_its_weights():
    pytest.importorskip("torch")
    from training.gorila.config import ConfigError, TrainConfig

    begun = {kind: TrainConfig(weights=kind, start="static").start_action() for kind in (PER_CELL, PER_METRE, DRAWN)}
    assert begun[PER_CELL] == begun[DRAWN] != begun[PER_METRE]
    assert TrainConfig(weights=PER_METRE, start="static_per_metre").start_action() == begun[PER_METRE]
    with pytest.raises(ConfigError, match="count per_metre, those of the run per_cell"):
        TrainConfig(weights=PER_CELL, start="static_per_metre").start_action()


def test_an_evaluation_drives_and_names_the_set_of_its_weights():
    runner = TrialRunner("kinematic")
    for kind in (PER_CELL, PER_METRE):
        trial = Trial("w", "static", 0, 0, "generated:0", "static", kind, "ours")
        assert runner._method(trial, None).weights == kind
    options = evaluation.EvaluationOptions(weights=(PER_CELL, PER_METRE))
    told = evaluation.settings(options, [], [("static", "static"), ("dwa", "dwa")])["methods"]
    assert told["static"]["per_metre"]["parameters"] != told["static"]["parameters"]
    assert set(told["dwa"]) == {*methods.make("dwa").describe(), "period_s"}
    assert told["static"]["parameters"]["max_vel_x"] == pytest.approx(methods.make("static").values[0])
