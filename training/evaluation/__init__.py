"""Trials of methods in worlds: trial.py, the runner that drives one, the table that keeps them, drive(), the score."""
