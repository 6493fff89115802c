"""Trains TD3 of stable-baselines3 in the environment, and writes its policy as an actor file.

The environment follows Gymnasium, so any library can learn in it. The file drives like the included
policy: `./applr demo method:=actor.safetensors`, or `./applr evaluate --methods
dwa,actor.safetensors`. A good policy needs about 100,000 steps; this example only shows the
procedure.
"""

import argparse

import gymnasium
import numpy as np
from stable_baselines3 import TD3
from stable_baselines3.common.noise import NormalActionNoise

import training.env
from applr_ros1.policy import actor


def weights_of(model: TD3) -> dict:
    """Return the layers of the policy by their names in an actor file: 0.weight, 0.bias, ..."""
    layers = [layer for layer in model.policy.actor.mu if hasattr(layer, "weight")]
    weights = {}
    for number, layer in enumerate(layers):
        weights["%d.weight" % number] = layer.weight.detach().cpu().numpy()
        weights["%d.bias" % number] = layer.bias.detach().cpu().numpy()
    return weights


def main() -> None:
    """Train, write the actor, and drive one course with it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--steps", type=int, default=500, help="decisions to learn from (default %(default)s)"
    )
    parser.add_argument(
        "--world", default="generated:0", help="course to drive (default %(default)s)"
    )
    parser.add_argument(
        "--out", default="actor.safetensors", help="file to write (default %(default)s)"
    )
    options = parser.parse_args()

    env = gymnasium.make(training.env.ID, worlds=options.world, simulator="kinematic")
    noise = NormalActionNoise(
        np.zeros(env.action_space.shape), np.full(env.action_space.shape, 0.3)
    )
    model = TD3(
        "MlpPolicy",
        env,
        action_noise=noise,
        learning_starts=50,
        policy_kwargs={"net_arch": [64, 64]},
        seed=0,
    )
    model.learn(options.steps, progress_bar=False)
    actor.save(
        options.out,
        weights_of(model),
        {"training": {"learner": "stable-baselines3", "steps": options.steps}},
    )

    policy = actor.load(options.out)
    observation, info = env.reset(seed=1)
    over = False
    while not over:
        observation, _, terminated, truncated, info = env.step(policy.action(observation))
        over = terminated or truncated
    print(
        "%s: %s after %.1f s"
        % (options.out, "goal reached" if info["success"] else "not reached", info["time_s"])
    )
    env.close()


if __name__ == "__main__":
    main()
