"""Drives: their data and topics, the loop of a simulated drive, its end, and the page of drives."""
