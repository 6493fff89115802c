"""APPLD: contexts of a demonstration, a parameter set for each context, and a classifier that selects the context."""
# Import rule: of this repository, modules here import only bags, env, td3 and common.
