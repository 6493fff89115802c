"""The robot's stand-in world: a simulated Jackal, its laser and its course."""
