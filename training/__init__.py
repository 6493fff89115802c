"""Learning: the meta-environment, TD3, actors and learner, datasets, evaluation and reports."""

import applr_ros1  # noqa: F401 - it makes Ctrl-C one line while the rest is imported
