"""Numerical methods that know nothing of actuators.

levenberg_marquardt  min |r(p)|^2 by damped normal equations;  geodesic_steps  the same with second-order steps
linear_recurrence    s_{t+1} = A s_t + b_t in two short passes instead of one long scan
intersample          v(t + f) between samples, from the neighbours
spline_derivative    x', ..., x^(n) of a sampled path
"""
