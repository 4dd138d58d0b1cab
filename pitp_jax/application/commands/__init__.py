"""The commands of `pitp`, one module each, with a function that runs the command and prints the result."""
