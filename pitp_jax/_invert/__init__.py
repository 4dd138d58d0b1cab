"""Invert a model: compute the voltage for a wanted motion (paper, eq. 13).

    F(t) = sigma_off + sum_i sigma_i(S, m) x^(i),    V = sqrt(max(F, 0)),    u = drive^-1(V)

Verb: `feedforward` (limits, lead-in, a check by rollout). `equation` is eq. 13 itself, `stream` computes it in blocks,
`realtime` one sample at a time, `discrete` inverts the decoder's own steps, `pi_control` closes the loop (Fig. 14).
"""

from .discrete import discrete_inverse as discrete_inverse
from .feedforward_plan import Feedforward as Feedforward
from .feedforward_plan import feedforward as feedforward
from .inverse import inverse as inverse
from .pi_control import pi_trim as pi_trim
from .realtime import CompiledStep as CompiledStep
from .realtime import decoder_step as decoder_step
from .realtime import inverse_step as inverse_step
from .realtime import restore_step as restore_step
from .stream import invert_stream as invert_stream
from .tokens import memory_along as memory_along
from .tokens import tokens_along as tokens_along
