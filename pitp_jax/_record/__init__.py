"""Host side (NumPy, float64): what a recording is, how it is read, filtered, and how excitations are made."""
