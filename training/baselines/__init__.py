"""Baselines that the learned policy is compared with."""
# Import rule: modules here import neither learner nor tuning.
