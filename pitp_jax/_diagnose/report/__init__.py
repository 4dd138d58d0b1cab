"""The report of a diagnosis: one HTML page with its figures inside, and the words both use."""
