"""Distributed training as in Gorila: one learner, many actors, the run, and its options."""
