"""The commands of `pitp`, one module each: a function of the parsed arguments that prints the result."""
