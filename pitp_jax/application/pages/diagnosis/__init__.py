"""The report of a diagnosis: one HTML page with its figures, and the words that page and terminal share."""
