"""`pitp identify`: fits a linear model of the lowest sufficient order to records."""

from ...files.model_file.model_file import save
from ...files.recordings.writing import write_text_atomic
from ...method.identify.identification import identify as run_identify
from ...method.model.units import units_of
from ...method.simulate.prediction import predict
from ..compare.description import describe
from ..pages.tables import orders as orders_table
from ..pages.tables import scores as scores_table
from .console import number, print_table, say
from .outputs import REPORT, check_outputs, staged
from .predict import scored
from .recordings import check_belongs, read_records, warn
from .reports import print_beginnings, print_model


def identify(records, out, order, input_map, learn, json_file, reading, leave_out=(), validate=(), report=None) -> int:
    """Identify a linear model, write the model file, and print the comparison of orders.

    Args:
        records: files and folders.
        out: model file to write.
        order: 1 to 6 or "auto".
        input_map: "square", "linear", or None: by the units of the recordings.
        learn, leave_out: ("delay",) to fit a pure delay in any case, or never.
        validate: files and folders of records used only for validation.
        report: folder for the Bode page, or None.
        json_file: where to write the result as JSON, or None.
        reading: keyword arguments of `pitp.read`: columns, units, scales, rate.

    Returns:
        3 if the model explains nothing of the held-out output, otherwise 0.

    Raises:
        BadInput, ComputationFailed: with nothing written.
    """
    check_outputs(out, json_file, folder=report, names=[REPORT], inputs=[*records, *validate])
    read_in = read_records(records, reading, input_map=input_map)
    warn(read_in)
    apart = read_records(validate, reading, input_map=input_map)
    identified = run_identify(read_in, order=order, input_map=input_map, learn=learn, leave_out=leave_out, progress=say)
    summary = describe(identified.model)
    if apart:
        check_belongs(identified.model, "the identified model", apart)
    scores = scored(apart, predict(identified.model, apart)) if apart else {}
    beginnings = {name: vars(b) for name, b in identified.beginnings.items()}
    value = {**summary, "orders": [*map(vars, identified.orders)], "rest": identified.rest, "beginnings": beginnings,
             "remarks": list(identified.remarks), "warning": identified.warning, "validation": scores}  # fmt: skip
    with staged(file=out, json_file=json_file, value=value) as stage:
        save(stage, identified.model)
    if report is not None:
        from ..pages.bode_page import bode_page  # imported here, because matplotlib takes half a second

        with staged(folder=report) as stage:
            write_text_atomic(stage / REPORT, bode_page(identified, out).html())
    if identified.warning:
        print(f"warning: {identified.warning}")
    print_table(orders_table(identified), 3)
    print_model(identified.model, summary)
    if identified.chosen.delay:
        print(delay_text(identified))
    print_beginnings(identified.beginnings, units_of(identified.model))
    for remark in identified.remarks:
        print(remark)
    if scores:
        print("validated on:")
        print_table(scores_table(scores, scores, {}), 3)
    return 0 if identified.explains else 3


def delay_text(identified) -> str:
    """Write the fitted delay, and the delay if the input behaved otherwise (held or linear) between samples."""
    delay, stderr = (1e3 * v for v in (identified.chosen.delay, identified.chosen.delay_stderr))
    half = 500 * identified.model.dt
    if identified.model.hold == "zoh":
        own, other, word = "held between samples", delay + half, "linear"
    else:
        own, other, word = "linear between samples", delay - half, "held"
    text = f"delay: {number(delay, 3)} +- {number(stderr, 2)} ms for an input {own}"
    text = f"{text} ({number(other, 3)} ms if the input is {word} between samples)"
    misfit = identified.model.origin.misfit
    # from 3 times the noise on, nine tenths of the residual's energy come from the model
    if 3.0 < misfit < float("inf"):
        text += f"; the linear model's error is {number(misfit, 2)} times the noise and can shift the delay by more"
    return text
