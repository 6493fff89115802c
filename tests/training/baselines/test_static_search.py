"""The search for the best single set, from start to a file that methods read."""

import json

import pytest

from applr_ros1.policy import methods
from applr_ros1.policy.parameter_space import SPACE
from tests.support.trial_tables import kept


def test_static_search_writes_a_set_that_methods_read(tmp_path, capsys):
    static_search = pytest.importorskip("training.static_search")

    out, log_path = tmp_path / "static.json", tmp_path / "static_log.json"
    start = tmp_path / "start.json"
    start.write_text(json.dumps({"max_vel_x": 2.0, "inflation_radius": 0.1}))
    arguments = ["--worlds=generated:140", "--generations=1", "--population=4", "--worlds-per-set=1", "--workers=0"]
    arguments += ["--final-worlds=generated:140", "--final-simulator=kinematic", "--final-trials=1", "--sigma=.1"]
    arguments += ["--start", str(start), "--out", str(out)]
    assert static_search.main(arguments) == 0
    assert methods.make(str(out)).theta(None).shape == (11,)
    log = json.loads(log_path.read_text())
    sets = [line["theta"] for line in log["finalists"]]
    assert SPACE.theta0.tolist() in sets
    assert SPACE.read(start).tolist() in sets
    assert log["result"] == log["finalists"][0]
    assert log["result"]["score"] == min(line["score"] for line in log["finalists"])
    table = tmp_path / "static_trials.sqlite"
    driven = kept(table)
    assert len(driven) > 4
    kept(table, first=4)  # as if killed then
    assert static_search.main(arguments) == 0  # the same command comes to the same result
    assert [line["theta"] for line in json.loads(log_path.read_text())["finalists"]] == sets
    assert kept(table) == driven
    assert static_search.start(str(log_path)).tolist() == sets[0]
    assert static_search.main(["--worlds", "generated:999", "--workers", "0", "--out", str(out)]) == 1
    assert capsys.readouterr().err.startswith("static_search.py: ")
