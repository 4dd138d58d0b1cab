"""`pitp fit`: trains a model on records."""

from collections.abc import Sequence
from dataclasses import replace

import jax

from ...common.errors import BadInput
from ...files.model_file.model_file import load, save
from ...files.recordings.writing import write_text_atomic
from ...method.identify.identification import Identification, identify, trains_from_order_two
from ...method.model.fitted import Fitted
from ...method.signal.excitation_kind import is_sweep
from ...method.signal.record import Record
from ...method.simulate.prediction import predict
from ...method.train.cross_validation import cross_validate as run_cross_validate
from ...method.train.cross_validation import with_held_out
from ...method.train.settings import preset_of
from ...method.train.training import Training, train
from ..compare.description import describe, fallback_line, in_words, sensor_line
from .console import ProgressLine, number, say
from .fit_errors import errors_json, explained, print_errors, suspects
from .outputs import REPORT, check_outputs, staged, write_json
from .predict import scored
from .recordings import check_belongs, read_records, warn
from .reports import listed, print_history


def fit(
    records, out, nominal, order, preset, learn, input_map, seed, report, reading, cross_validate=False, json_file=None,
) -> int:  # fmt: skip
    """Train a model, write the model file, and print the training history and the error on every record.

    Args:
        records: files and folders; all of them train.
        out: model file to write.
        nominal: model file to start from, or None to identify one.
        order: 1 to 6, "auto" or None; must not contradict `nominal`.
        input_map: "square", "linear" or None; must not contradict `nominal`.
        preset: "default" or "paper".
        learn: parts between amplifier and sensor learned with it, "delay" and "sensor_lag".
        seed: of the random start.
        report: folder for a page on the fit, or None.
        reading: keyword arguments of `pitp.read`: columns, units, scales, rate.
        cross_validate: whether every record is also predicted by a model trained on the others.
        json_file: where to write the errors as JSON, or None.

    Returns:
        3 if the model explains nothing of the output, otherwise 0.

    Raises:
        BadInput, ComputationFailed: with nothing written.
        KeyboardInterrupt: interrupted; the best complete model is written if a stage was complete.
    """
    check_outputs(out, json_file, folder=report, names=[REPORT], inputs=[*records, nominal])
    given = _given(nominal, order, input_map) if nominal else None
    read_in = read_records(records, reading, input_map=given.input_map.name if given else input_map)
    warn(read_in)

    def identified(some: Sequence[Record]) -> Identification:
        return _identified(some, order or "auto", input_map)

    first, start = None, given
    if start is None:
        first = identified(read_in)
        start = first.model
    check_belongs(start, nominal or "the identified model", read_in)
    settings = replace(preset_of(preset), parts=tuple(dict.fromkeys(learn)))
    how = {"settings": settings, "key": jax.random.key(seed)}
    done, held_out = train(start, read_in, progress=ProgressLine().train, **how), ()
    save(out, done.model)
    if report is not None:
        _report(done.model, read_in, report, out)
    if done.interrupted:
        raise KeyboardInterrupt(f"the best complete model is in {out}")
    explains, warning = explained(done.errors, read_in, first)
    _print_training(done, [r.name for r in read_in], warning)
    if cross_validate:
        say(f"cross-validation: {len(done.errors)} trainings, each without one recording")
        held_out = run_cross_validate(
            given or (lambda some: identified(some).model), read_in, done.model, progress=ProgressLine().train, **how
        )
        save(out, with_held_out(done.model, held_out))
    print_errors(done.errors, held_out)
    for line in [*done.problems, *suspects(held_out)]:
        say(f"warning: {line}")
    summary = {**errors_json(done.errors, held_out), "problems": list(done.problems), "fallback": done.fallback,
               "warning": warning}  # fmt: skip
    write_json(json_file, summary)
    print(f"wrote {out}; `pitp predict {out} RECORDS` scores it")
    return 0 if explains else 3


def _print_training(done: Training, names: Sequence[str], warning: str | None) -> None:
    """Print how a model was trained: warnings, order, recordings, time, history and effects."""
    summary, seconds = describe(done.model), number(done.notes.get("seconds"), 3)
    if warning:
        print(f"warning: {warning}")
    if line := fallback_line(done.notes):
        print(line)
    print(f"trained a model of order {summary['order']} on {listed(done.notes.get('records', names))} in {seconds} s")
    print(sensor_line(done.model))
    for line in done.notes.get("left_out", ()):
        print(line)
    print_history(done.history)
    for effect in summary["effects"]:
        print(f"with {in_words(effect)}")


def _report(model: Fitted, records: Sequence[Record], folder: str, name: str) -> None:
    """Write the page that compares simulations of the model with the training records."""
    from ..pages.fit_page import fit_page  # imported here, because matplotlib takes half a second

    runs = predict(model, records)
    with staged(folder=folder) as stage:
        page = fit_page(model, records, runs, scored(records, runs), name)
        write_text_atomic(stage / REPORT, page.html())


def _given(path: str, order, input_map) -> Fitted:
    """Load the nominal model from a file; refuse options that contradict it."""
    model = load(path)
    for what, asked, own in (("order", order, model.order), ("input map", input_map, model.input_map.name)):
        if asked not in (None, "auto", own):  # None and "auto" leave it to the file
            option = f"--{what.replace(' ', '-')} {asked}"
            raise BadInput(f"{option} contradicts {path}, whose {what} is {own}; leave one of them out")
    return model


def _identified(records, order, input_map) -> Identification:
    """Identify a nominal model on the sweeps among the records, or on all records if there is no sweep."""
    sweeps = [record for record in records if is_sweep(record)]
    if sweeps:
        say(f"identifying on the sweeps among {len(records)} recordings: {listed([r.name for r in sweeps])}")
    else:
        say(f"no recording is a sweep: identifying on all, {listed([r.name for r in records])}")
    identified = identify(sweeps or records, order=order, input_map=input_map, progress=say)
    say(f"identified order {identified.model.order}")
    if order == "auto" and trains_from_order_two(identified):
        say("order 2 predicts as well, and training cannot add the mass that order 1 lacks: identifying order 2")
        input_map = identified.model.input_map.name
        identified = identify(sweeps or records, order=2, input_map=input_map, progress=say)
    return identified
