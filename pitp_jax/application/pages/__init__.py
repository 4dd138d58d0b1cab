"""Draw figures (data in m, V and s, shown in mm, V or kV, and s), format numbers, and write pages."""
