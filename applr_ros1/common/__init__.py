"""Helpers that several packages share; they import none of them."""
