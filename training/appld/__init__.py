"""APPLD: demonstrations, their contexts, a parameter set for each, and a context classifier."""
