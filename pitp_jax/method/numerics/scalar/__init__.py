"""JAX programs as scalar expressions, for whoever prints them in another language."""
