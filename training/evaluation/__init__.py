"""Trials of methods in worlds: protocols, the runner that drives them, their store, the score, periodic evaluation."""
