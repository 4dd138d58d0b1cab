"""Numerical methods that are independent of actuators.

minimise             min |r(p)|^2 by damped normal equations: straight steps within bounds, or curved steps
linear_recurrence    lags and oscillators, exact for an input linear between samples
intersample          v(t + f) between samples, from the neighbours
spline_derivative    x', ..., x^(n) of a sampled path
"""
