"""Save and load model files of identified, trained and augmented models; no code in a file is ever run.

Verbs: `save`, `load`. A file is a list of named parts with plain values, and their arrays, with a digest.
"""

from .lineage import descended as descended
from .model_file import digest as digest
from .model_file import load as load
from .model_file import save as save
