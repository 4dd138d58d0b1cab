"""Fit free runs to recordings as one least-squares problem.

min_p |free run(p) - record|^2 + |(p - p0) / sd|^2
"""
