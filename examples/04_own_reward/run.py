"""A reward with a term of one's own, compared with the standard reward on the same drive.

ApplrEnv takes any Reward. This one also charges for hurrying past obstacles: for each decision, the distance driven per
metre of free space. A term that is to be an option of train.py is added in training/env/reward.py.
"""

import argparse

from training.env.env import ApplrEnv
from training.env.reward import Reward


class Considerate(Reward):
    """The standard reward and a term of our own.

    Attributes:
        c_hurry: price of driving one metre where the nearest obstacle is one metre away; twice that at half a metre.
    """

    c_hurry: float = 0.2

    def __call__(self, outcome, change, *limits):
        """The reward of one decision and its terms, by name."""
        total, terms = super().__call__(outcome, change, *limits)
        hurry = -self.c_hurry * abs(outcome.progress) / max(outcome.decision_min, 0.1)
        return total + hurry, dict(terms, hurry=hurry)


def drive(reward: Reward, world: str, decisions: int) -> dict:
    """Drive with the default parameters; the sum of each term."""
    env = ApplrEnv(worlds=world, simulator="kinematic", period=2.0, reward=reward)
    env.reset(seed=0, options={"simulator_seed": 0})
    default = env.space.to_action(env.space.theta0)
    sums = {}
    for _ in range(decisions):
        _, _, terminated, truncated, info = env.step(default)
        for name, value in info["reward"].items():
            sums[name] = sums.get(name, 0.0) + value
        if terminated or truncated:
            break
    env.close()
    return sums


def main() -> None:
    """Print the terms of both rewards side by side."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--world", default="generated:0", help="course to drive (default %(default)s)")
    parser.add_argument("--decisions", type=int, default=50, help="at most (default %(default)s)")
    options = parser.parse_args()
    standard = drive(Reward(), options.world, options.decisions)
    ours = drive(Considerate(), options.world, options.decisions)
    for name in ours:
        print("%-12s %8s %8.2f" % (name, "%.2f" % standard[name] if name in standard else "-", ours[name]))
    print("%-12s %8.2f %8.2f" % ("total", sum(standard.values()), sum(ours.values())))


if __name__ == "__main__":
    main()
