"""Attempts: what else could be set, paired drives with it, and whether it is better."""
