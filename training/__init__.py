"""Learning: the meta-environment, TD3, actors and learner, datasets, evaluation and reports."""
