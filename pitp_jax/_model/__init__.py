"""Pytrees: the one kind of model that is identified, trained, rolled out, inverted, saved and diagnosed."""
