"""Parameter tuning for the planner of a robot (./applr tune): the search and its output files."""
# Import rule: modules here may import every subpackage of training except learner and baselines.
