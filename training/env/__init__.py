"""The learning problem: the Gymnasium environment, the episode that joins planner and simulator, and the reward."""
