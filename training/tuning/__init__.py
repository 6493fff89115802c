"""Better parameters for the planner that a robot runs: the search, what a set is written as, and the page about it."""
