"""pitp_jax: model, invert and diagnose dielectric elastomer actuators from recordings.

    records -> identify -> train -> predict / feedforward
                           diagnose -> a model with the missing effect

The public names stand in `__init__.pyi`, once; each loads on first use, so that `pitp --help` does not wait for JAX.
"""

import lazy_loader

__version__ = "0.2.0"
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
