"""Training of a policy (train.py): TD3, replay buffer, distributed learner, recipes, and data from recorded drives."""
