"""Distributed training as in Gorila: one learner, many actors, the training run, and its options."""
# Import rule: modules here may import all packages of training except baselines and tuning.
