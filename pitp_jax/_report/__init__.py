"""Figures on axes the caller may supply (data in m, V and s, shown in mm, V or kV, and s), numbers and pages."""
