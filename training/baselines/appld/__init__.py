"""APPLD, the paper's second baseline: contexts from a demonstration, a parameter set for each, and a classifier."""
