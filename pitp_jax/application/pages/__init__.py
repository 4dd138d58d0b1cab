"""Pages of all results, figures with their numbers, and a model in plain values."""
