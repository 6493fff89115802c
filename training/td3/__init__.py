"""TD3 and its networks."""
# Import rule: of this repository, modules here import only common. They know neither the replay buffer nor robots.
