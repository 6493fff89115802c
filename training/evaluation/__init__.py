"""Evaluation trials: methods, protocols, the workers that drive them, their store, and periodic evaluation during training."""  # noqa: E501
