"""Write identified parameters into a MuJoCo file, and simulate the recorded commands in MuJoCo to verify them.

    SimToReal + arm.xml -> changes of attributes -> arm_identified.xml -> commands in MuJoCo -> gap before, after

Needs the `mujoco` package (extra `mujoco`); it is imported when a file is written or played.
"""
