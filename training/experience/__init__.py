"""Experience as data: trajectories, the replay buffer, the journal on disk, and datasets."""
