"""Baselines that the learned policy is compared with."""
