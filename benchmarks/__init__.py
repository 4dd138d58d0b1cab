"""Benchmarks: what the package costs and what it is worth beside other ways to do the same."""
