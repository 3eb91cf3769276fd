"""The proof: renders a candidate next to its source and measures the difference."""
