"""The package itself: tokens read off the state, trained by `pitp.train` with one of its presets."""

import sys

import pitp_jax as pitp

from .constant import predictor


def fit(nominal, records, seconds, key, *, preset):
    """Train with a preset exactly as it is; it ends by its own rules, not by `seconds`."""

    def tell(progress):
        print(f"  {progress.stage} {progress.step}/{progress.steps} loss {progress.loss:.3g}", file=sys.stderr)

    return predictor(pitp.train(nominal, records, preset=preset, progress=tell, key=key).model)
