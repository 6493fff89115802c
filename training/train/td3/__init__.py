"""TD3 and its networks."""
