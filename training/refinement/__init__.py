"""A search around a learnt policy by driving alone, without critics. refine_policy.py starts it."""
