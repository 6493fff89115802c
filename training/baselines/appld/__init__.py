"""APPLD: contexts of a demonstration, a parameter set for each, and a classifier that chooses among them."""
# Imports bags, env and common.
