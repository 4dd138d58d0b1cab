"""The step of a free run as machine code: the same JAX step, printed as LLVM text in explicit vectors."""
