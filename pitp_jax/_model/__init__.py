"""The model: one immutable pytree that is identified, trained, simulated, inverted, diagnosed and saved.

    F = sigma_off + sum_i sigma_i(S, m) x^(i),    F = map(V),  V = drive(u),    S = [x, ..., x^(n-1)]  (paper, eqs. 2-7)

Parts: encoder (features to tokens), memory (features beside S), input map (u^2 or u), drive (the electrodes), output
(sensor offset and direction), domain (range of the training data) and the effects of `_effects`. A `Fitted` is a model
with its origin.
"""

from .domain import Domain as Domain
from .drive import DirectDrive as DirectDrive
from .drive import ElectrodeLag as ElectrodeLag
from .encoder import AbstractEncoder as AbstractEncoder
from .encoder import AdaptedEncoder as AdaptedEncoder
from .encoder import CompactEncoder as CompactEncoder
from .encoder import ConstantEncoder as ConstantEncoder
from .encoder import PaperEncoder as PaperEncoder
from .fitted import Fitted as Fitted
from .input_map import LinearInput as LinearInput
from .input_map import SquareInput as SquareInput
from .memory import ElapsedTime as ElapsedTime
from .memory import FadingMemory as FadingMemory
from .memory import NoMemory as NoMemory
from .memory import RingingMemory as RingingMemory
from .model import Hold as Hold
from .model import Model as Model
from .model import Output as Output
from .model import Scales as Scales
from .model import linear_model as linear_model
from .origin import Origin as Origin
from .own_encoder import OwnEncoder as OwnEncoder
