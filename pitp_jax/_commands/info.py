"""`pitp info`: what a model file holds."""

from .._model_file.model_file import load
from .outputs import check_files, write_json
from .reports import describe, print_model


def info(model, json_file) -> None:
    """Print a model's order, coefficients, modes and history.

    Args:
        model: model file.
        json_file: where to write the same for machines, or None.

    Raises:
        BadInput: not a usable model file.
    """
    check_files(json_file, inputs=[model])
    told = describe(load(model))
    if json_file:
        write_json(json_file, told)
    print_model(told)
