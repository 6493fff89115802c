"""Parameter policy: space, observations, actor, and other methods that choose parameters."""
