"""Experience: trajectories, the replay buffer, and datasets on disk."""
# Imports no other package of training.
