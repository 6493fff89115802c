"""Test of a run that starts from the file of a policy."""

import numpy as np

from applr_ros1 import robots
from applr_ros1.policy.actor import save, with_mirror_images
from applr_ros1.policy.dimensionless import DimensionlessEncoding
from applr_ros1.policy.encoding import PaperEncoding
from tests.support.refusals import refused
from tests.support.robots import make_weights
from tests.support.runs import one_line
from training.env.trajectory import TransitionLayout
from training.train.__main__ import main
from training.train.learner.learner import Learner, LearnerOptions, policy_network

JACKAL = robots.load("jackal")
HUSKY = robots.load("husky")
WORLDS = ["--worlds", "generated:7,dynamic:100"]


def test_a_policy_is_taken_over_for_another_robot_and_frozen_during_the_warm_up(tmp_path):
    # Given: a policy of the Jackal with its mirror image
    encoding = DimensionlessEncoding(JACKAL, 1.0)
    weights = make_weights(hidden=(16,), inputs=encoding.size, outputs=encoding.actions)
    single = {name: tensor[None] for name, tensor in weights.items()}
    policy = str(tmp_path / "jackal.safetensors")
    save(policy, with_mirror_images(single, encoding.mirror), encoding=encoding)

    layout = TransitionLayout.of(DimensionlessEncoding(HUSKY, 1.0))

    def learner(layout=layout, size=16):
        """Return a learner for the Husky that begins with the policy."""
        options = LearnerOptions(net_arch=[size])
        return Learner(layout, options, tmp_path / "run", 50, policy, HUSKY)

    # Then: its network is that of the learner, whose critics learn first
    td3 = learner().td3
    for layer_name, tensor in td3.actor_weights().items():
        assert np.array_equal(tensor, weights[layer_name]), layer_name
    assert td3.policy_starts > 0
    # Networks of another size, and of another encoding
    refused(lambda: learner(size=8), "the same --net-arch")
    refused(lambda: learner(TransitionLayout()), "the same --net-arch, --observation, ")


def test_a_policy_of_another_robot_in_the_papers_encoding_is_refused(tmp_path, capsys):
    policy = tmp_path / "jackal.safetensors"
    save(policy, make_weights(hidden=(8,)), encoding=PaperEncoding(JACKAL))
    assert policy_network(str(policy), JACKAL)
    options = ["--robot", "turtlebot3_burger", "--init-from", str(policy), "--net-arch", "8"]
    refusal = "made for the robot jackal: this robot is turtlebot3_burger"
    one_line(capsys, [*options, *WORLDS, "--out", tmp_path / "run"], refusal, main)
