"""What a person sees: commands, pages, comparisons, checks, plans."""
