"""Numerical methods that know nothing of actuators.

levenberg_marquardt  min |r(p)|^2 by damped normal equations;  geodesic_steps  the same with second-order steps
linear_recurrence    lags and oscillators, exact for an input linear between samples
intersample          v(t + f) between samples, from the neighbours
spline_derivative    x', ..., x^(n) of a sampled path
"""
