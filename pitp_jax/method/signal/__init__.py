"""Recordings as signals: one excitation of one actuator, its noise, band, excitation and initial state.

    measured = direction x(t) + offset + noise

NumPy float64 in base units; missing output samples are nan. `reduced` is the one place that averages samples.
"""
