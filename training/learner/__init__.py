"""Distributed training after Gorila: one learner, many actors, the scheduler, and the options of a run."""
# Imports every room but baselines and tuning.
