"""Training of a policy: TD3, replay buffer, learner, recipes, and data from recorded drives."""
