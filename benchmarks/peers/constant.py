"""Constant tokens: sum_i a_i x^(i) = u^2, the identified linear model every other peer starts from."""

import pitp_jax as pitp


def predictor(model):
    """Free run of a model of the package."""

    def predict(record):
        return pitp.predict(model, [record])[0].displacement

    return predict


def fit(nominal, records, seconds, key):
    """Nothing to fit: the identification is the model."""
    return predictor(nominal)
