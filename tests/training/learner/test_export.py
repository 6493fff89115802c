"""What leaves the training: the actor as ONNX, and the search for the best single set."""

import json

import numpy as np
import pytest

from applr_ros1.common.tensors import unpack
from applr_ros1.policy import actor as actors
from applr_ros1.policy import methods
from applr_ros1.policy.network import Mirror
from applr_ros1.policy.parameter_space import SPACE
from tests.support.trial_tables import kept
from training import export


@pytest.fixture(params=["one network", "two side by side"])
def actor_file(tmp_path, request):
    from training.td3.td3 import TD3, TD3Options

    td3 = TD3(729, 8, TD3Options(symmetric="two" in request.param), seed=4, mirror=Mirror.of(720, 9))
    actors.save(tmp_path / "some.safetensors", td3.actor_weights(), {"training": {"steps": 3}, "result": None})
    return tmp_path / "some.safetensors"


def test_onnx_equals_the_actor(actor_file, tmp_path):
    assert export.main([str(actor_file), str(tmp_path / "some.onnx")]) == 0
    model = (tmp_path / "some.onnx").read_bytes()
    assert export.difference(actors.load(actor_file), model) < 1e-5
    import onnx

    properties = {p.key: p.value for p in onnx.load_from_string(model).metadata_props}
    assert json.loads(properties["training"]) == {"steps": 3}
    assert "names" in properties["space"]


def test_an_export_that_differs_is_an_error(actor_file, tmp_path, capsys, monkeypatch):
    exported = export.to_onnx(actors.load(actor_file))
    weights, _ = unpack(actor_file.read_bytes(), "file")
    actors.save(actor_file, dict(weights, **{"3.bias": weights["3.bias"] + np.float32(1e-3)}))
    monkeypatch.setattr(export, "to_onnx", lambda actor: exported)  # of another network than is in the file
    assert export.main([str(actor_file), str(tmp_path / "some.onnx")]) == 1
    assert "differs" in capsys.readouterr().err
    assert not (tmp_path / "some.onnx").exists()
    assert export.main([str(tmp_path / "nothing"), str(tmp_path / "some.onnx")]) == 1


def test_static_search_writes_a_set_that_methods_read(tmp_path, capsys):
    pytest.importorskip("cma")
    from training import static_search

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
