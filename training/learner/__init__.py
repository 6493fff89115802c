"""Distributed training after Gorila: one learner, many actors, the scheduler between them, and the options of a run."""
