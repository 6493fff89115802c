"""Parameter tuning for the planner of a robot (./applr tune): the search and its output files."""
# Import rule: of this repository, modules here import only every subpackage of training except learner and baselines.
