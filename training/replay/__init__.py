"""Experience: trajectories, the replay buffer, and datasets on disk."""
# Import rule: modules here import no other package of training.
