"""Errors, units, quantities, metrics and the text of results: what every storey uses."""
