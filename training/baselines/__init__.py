"""Baselines that the learned policy is compared with."""
# Import no learner and no tuning.
