"""Tubes of a trunk mesh: find them, plan which rings and sides to keep, build them anew."""
