"""Save and load model files of identified, trained and augmented models; no code in a file is ever run.

Verbs: `save`, `load`. A file is a list of named parts with plain values, and their arrays, with a digest.
"""
