"""Better parameters for the planner that a robot runs (./applr tune): the search and what it writes."""
# Imports every room but learner and baselines.
