"""Experience as data: trajectories, the replay buffer that is learnt from, and the store on disk."""
