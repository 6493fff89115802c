"""Experience: trajectories, the replay buffer, and datasets on disk."""
