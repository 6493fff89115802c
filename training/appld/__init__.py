"""APPLD (appld.py): demonstrations, their contexts, a parameter set for each, and a classifier of the context."""
