"""What leaves the training: the actor as ONNX and TorchScript, and the search for the best single set."""

import json

import numpy as np
import pytest

from applr_ros1.policy import actor as actors
from applr_ros1.policy import methods
from applr_ros1.policy.parameter_space import SPACE
from training import export


@pytest.fixture
def actor_file(tmp_path):
    from training.td3.td3 import TD3

    actors.save(
        tmp_path / "some.safetensors", TD3(729, 8, seed=4).actor_weights(), {"training": {"steps": 3}, "result": None}
    )
    return tmp_path / "some.safetensors"


def test_onnx_and_torchscript_equal_the_actor(actor_file, tmp_path, capsys):
    pytest.importorskip("onnxruntime")
    assert export.main([str(actor_file), str(tmp_path / "out")]) == 0
    actor = actors.Actor.load(actor_file)
    onnx_bytes = (tmp_path / "out" / "some.onnx").read_bytes()
    script = (tmp_path / "out" / "some.pt").read_bytes()
    assert export.difference(actor, onnx_bytes, script) < 1e-5
    import onnx

    properties = {p.key: p.value for p in onnx.load_from_string(onnx_bytes).metadata_props}
    assert json.loads(properties["training"]) == {"steps": 3}
    assert "names" in properties["space"]


def test_an_export_that_differs_is_an_error(actor_file, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(export, "difference", lambda *a, **k: 1e-3)
    assert export.main([str(actor_file), str(tmp_path / "out")]) == 1
    assert "differs" in capsys.readouterr().err
    assert not list((tmp_path / "out").glob("*"))
    assert export.main([str(tmp_path / "nothing"), str(tmp_path / "out")]) == 1


def test_static_search_writes_a_set_that_methods_read(tmp_path, capsys):
    pytest.importorskip("cma")
    pytest.importorskip("gymnasium")
    from training import static_search

    out = tmp_path / "static.json"
    arguments = ["--worlds=generated:140", "--generations=1", "--population=4", "--worlds-per-set=1", "--actors=0"]
    assert static_search.main([*arguments, "--out", str(out)]) == 0
    assert methods.make(str(out)).theta(None).shape == (8,)
    log = json.loads((tmp_path / "static_log.json").read_text())
    assert log["trials"] == 4 + len(log["finalists"])
    assert log["log"][0]["generation"] == 0
    assert log["finalists"][0]["theta"] == pytest.approx(SPACE.theta0.tolist())
    assert log["result"]["score"] == min(f["score"] for f in log["finalists"][1:])
    more = tmp_path / "more.json"
    arguments += ["--sigma", ".01", "--start", str(tmp_path / "static_log.json")]
    assert static_search.main([*arguments, "--out", str(more)]) == 0
    assert "generation 2 of 2" in capsys.readouterr().out
    went_on = json.loads((tmp_path / "more_log.json").read_text())["log"]
    assert [line["generation"] for line in went_on] == [0, 1]
    assert went_on[0] == log["log"][0]
    assert SPACE.to_action(went_on[1]["mean"]["theta"]) == pytest.approx(
        np.clip(SPACE.to_action(log["log"][0]["mean"]["theta"]), -0.9, 0.9), abs=0.15
    )
    assert static_search.main(["--worlds", "generated:999", "--actors", "0", "--out", str(out)]) == 1
    assert capsys.readouterr().err.startswith("static_search.py: ")
