"""Distributed training as in Gorila: one learner, many actors, the training run, and its options."""
# Imports all packages of training except baselines and tuning.
