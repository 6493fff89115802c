"""Parameter tuning for the planner of a robot (./applr tune): the search and its output files."""
