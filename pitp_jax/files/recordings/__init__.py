"""Read files into checked recordings in base units, as NumPy float64.

Verbs: `read` (files and folders to records), `read_target` (a wanted motion), `read_voltage` (an input alone). A record
is one excitation of one actuator, sampled uniformly; missing output samples are nan. `writing` writes files completely
or not at all.
"""
