"""An actor of another project as a method: the BARN Challenge's layout, a network file made here, and every mistake."""

import os
import subprocess
import sys

import numpy as np
import pytest
import torch

from applr_ros1.common.errors import ApplrError
from applr_ros1.policy import methods
from applr_ros1.policy.methods.check import scenes
from applr_ros1.policy.parameter_space import SPACE
from tests.support import ROOT

FILE = ROOT / "examples" / "06_foreign_actor" / "barn_actor.py"
RANGES = [(0.2, 2.0), (0.314, 3.14), (4, 12), (8, 40), (0.1, 1.5), (0.1, 2.0), (0.1, 0.6)]
OUTPUTS = [
    "max_vel_x",
    "max_vel_theta",
    "vx_samples",
    "vtheta_samples",
    "pdist_scale",
    "gdist_scale",
    "inflation_radius",
]


@pytest.fixture
def network():
    """A network as the authors': an encoder, a head and a last layer, with random weights."""
    torch.manual_seed(3)
    parts = {"encoder": (721, 32, 32), "head": (32, 16), "last": (16, 7)}
    made = torch.nn.ModuleDict()
    for name, sizes in parts.items():
        made[name] = torch.nn.Sequential(*[torch.nn.Linear(a, b) for a, b in zip(sizes, sizes[1:])])
    return made


def theirs(network, context):
    """The parameters by the layout as it is published, computed by torch."""
    scan = (np.minimum(context.ranges, 2.0) - 1.0) / 2.0
    x = torch.from_numpy(np.append(scan, context.phi / (2.0 * np.pi)).astype(np.float32))
    layers = [layer for part in network.values() for layer in part]
    for layer in layers[:-1]:
        x = torch.relu(layer(x))
    action = torch.tanh(layers[-1](x)).detach().numpy()
    return {name: low + (a + 1.0) / 2.0 * (high - low) for name, a, (low, high) in zip(OUTPUTS, action, RANGES)}


@pytest.fixture
def actor(network, tmp_path):
    """The network's file, made of torch's as the tutorial says."""
    torch.save(network.state_dict(), tmp_path / "policy.pt")
    page = (ROOT / "docs" / "tutorials" / "own_method.md").read_text()
    lines = page.partition("```python\nimport torch")[2].partition("```")[0]
    subprocess.run([sys.executable, "-c", "import torch" + lines], cwd=tmp_path, check=True)
    return tmp_path / "actor.safetensors"


def test_chooses_what_the_network_says(network, actor):
    method = methods.make("%s:BarnActor:%s" % (FILE, actor))
    assert method.period == 1.0
    methods.check_method(method)
    chosen = []
    for context in scenes(6):
        found, wanted = SPACE.as_dict(method.theta(context)), theirs(network, context)
        assert found["occdist_scale"] == SPACE.theta0[SPACE.names.index("occdist_scale")]
        for name, value in wanted.items():
            whole = SPACE.integer[SPACE.names.index(name)]
            assert found[name] == pytest.approx(round(value) if whole else value, abs=1e-5), name
        chosen.append(tuple(found.values()))
    assert len(set(chosen)) == 6
    assert method.describe()["file"] == "actor.safetensors"


def test_is_evaluated_from_the_current_folder_with_its_own_period(actor, tmp_path):
    (tmp_path / "barn_actor.py").write_text(FILE.read_text())
    command = [sys.executable, "-m", "training.evaluate", "--worlds", "generated:0", "--trials", "1", "--no-report"]
    command += ["--methods", "a=barn_actor.py:BarnActor:actor.safetensors,b=barn_actor:BarnActor:actor.safetensors"]
    command += ["--simulator", "kinematic", "--workers", "0"]
    environment = dict(os.environ, PYTHONPATH=str(ROOT))
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    one, other = (tmp_path / "results" / "trials.csv").read_text().splitlines()[1:]
    assert one == other.replace(",b,", ",a,")
    seconds, decisions = float(one.split(",")[7]), int(one.split(",")[8])
    assert decisions == np.ceil(seconds) > 5


def test_what_cannot_be_is_one_line(network, actor, tmp_path, capsys):
    def refused(spec, words):
        with pytest.raises(ApplrError, match=words) as error:
            methods.make(spec).theta(scenes(1)[0])
        assert "\n" not in str(error.value)

    refused("%s:BarnActor" % FILE, "needs the file of its network")
    refused("%s:BarnActor:/nowhere" % FILE, "/nowhere: cannot be read")
    refused("%s:Nothing" % FILE, "has no attribute 'Nothing'")
    refused("/nowhere/my_actor.py:Nothing", "cannot be made")
    for name, line, words in (
        ("Six", "ranges = {'max_vel_x': (0.2, 2.0)}", "layer 3 has shapes"),
        ("Unknown", "ranges = {'speed': (0.0, 1.0)}", "ranges name speed; give some of max_vel_x"),
        ("Short", "inputs = lambda self, context: [0.0]", r"gave shape \(1,\), not \(721,\)"),
        ("Raises", "inputs = lambda self, context: context.nothing", "inputs.context. raised AttributeError"),
        ("Wild", "inputs = lambda self, context: [float('nan')] * 721", "not finite"),
    ):
        file = tmp_path / ("my_%s.py" % name)
        file.write_text(FILE.read_text() + "\n\nclass %s(BarnActor):\n    %s\n" % (name, line))
        refused("%s:%s:%s" % (file, name, actor), words)
