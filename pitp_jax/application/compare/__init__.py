"""Compare two models or two sets of recordings, and report what differs beyond its confidence interval.

    differs:  |b - a| > 1.96 sqrt(s_a^2 + s_b^2)

Verb: `compare`. Recordings are paired by their commands, and by their responses where commands repeat (`pairing`).
"""
