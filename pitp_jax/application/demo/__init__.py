"""Run `pitp demo`: the paper's experiments on a virtual actuator, from recordings to tracked motion."""
