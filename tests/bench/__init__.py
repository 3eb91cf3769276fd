"""Benchmarks: the figures that the project promises, each measured by a command (`make bench`)."""
