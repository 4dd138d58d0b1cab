"""The two ways a user's request ends early; the command line turns them into exit codes 2 and 3."""


class BadInput(ValueError):
    """Bad input or usage: one line that names the file, the place and the remedy (exit code 2)."""


class ComputationFailed(RuntimeError):
    """The computation itself failed (diverged, order not identifiable): one line with advice (exit code 3)."""
