"""Invert a model: compute the voltage for a wanted motion (paper, eq. 13).

    F(t) = sigma_off + sum_i sigma_i(S, m) x^(i),    V = sqrt(max(F, 0)),    u = drive^-1(V)

Verb: `feedforward` (limits, lead-in, a check by rollout). `equation` is eq. 13 itself, `stream` computes it in blocks,
`realtime` one sample at a time, `discrete` inverts the decoder's own steps, `pi_control` closes the loop (Fig. 14).
"""
