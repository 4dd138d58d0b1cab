"""Train a model: add an encoder to a nominal model, from recordings (paper, Algorithm 1 and eq. 12).

    1. min Huber(theta(X) . X - F) + soft box on the tokens, the box widening in stages     (`equation_error`)
    2. min |free run - record|^2 + prior, by Levenberg-Marquardt                             (`refine`)
    3. compare every record with the nominal model; other starts where that did not converge  (`errors`)

Verb: `train`; `cross_validate` leaves one record out; `train_ensemble` and `predict_band`: spread over random starts.
"""
