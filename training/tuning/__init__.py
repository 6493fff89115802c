"""Parameter tuning for the planner of a robot (./applr tune): the search and its output files."""
# May import every subpackage of training except learner and baselines.
