"""Train a model: add an encoder to a nominal model, from recordings (paper, Algorithm 1 and eq. 12).

    1. min Huber(theta(X) . X - F) + soft box on the tokens, the box widening in stages     (`equation_error`)
    2. min |free run - record|^2 + prior, by Levenberg-Marquardt                             (`refine`)
    3. compare every record with the nominal model; other starts where that did not converge  (`errors`)

Verb: `train`; `cross_validate` leaves one record out; `train_ensemble` and `predict_band`: spread over random starts.
"""

from .cross_validation import HeldOut as HeldOut
from .cross_validation import cross_validate as cross_validate
from .ensemble import Band as Band
from .ensemble import Ensemble as Ensemble
from .ensemble import predict_band as predict_band
from .ensemble import train_ensemble as train_ensemble
from .residual import residual as residual
from .residual import residual_loss as residual_loss
from .settings import Settings as Settings
from .training import Training as Training
from .training import train as train
