"""Parameter policy: parameter space, observations, actor, and other methods that choose parameters."""
