"""Episodes of random numbers, for tests of replay, datasets and learning."""

import numpy as np

from training.env.trajectory import Trajectory


def episode(layout, number, t=3, terminated=False, **info):
    """Return an episode of t transitions in a layout, drawn with the seed `number`."""
    rng = np.random.default_rng(number)
    observations, actions = (
        rng.uniform(-1, 1, (t + 1, layout.size)),
        rng.uniform(-1, 1, (t, layout.action)),
    )
    return Trajectory.of(layout, observations, actions, rng.normal(size=t), terminated, info)
