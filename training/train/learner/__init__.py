"""Distributed training as in Gorila: one learner, many actors, the training run, and its options."""
