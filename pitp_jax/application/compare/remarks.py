"""Write remarks on how the recordings of two sets were paired."""

from collections.abc import Sequence

import numpy as np

from ...common.numbers import number
from ...common.units import from_base
from .pairing import Pairing

_LISTED = 12  # names in one sentence; the JSON holds all


def remarks_on(pairing: Pairing, first: str, second: str) -> list[str]:
    """Write remarks on clocks, unpaired recordings and signs; `first`, `second` name the sets of recordings."""
    named = [f"{p.first.name} with {p.second.name}" for p in pairing.pairs if p.first.name != p.second.name]
    lines = []
    if named:
        lines.append(f"Paired by their commands ({first} with {second}): {_listed(named)}.")
    lines += _of_ties(pairing, first, second)
    lines += _of_offsets(pairing, first, second)
    lines += _of_signs(pairing, second)
    offsets = [p.offset for p in pairing.pairs]
    sizes = sorted(map(abs, offsets))
    # below 0.1 ms it is an interpolation error
    if sizes and sizes[-1] >= 1e-4:
        middle, apart = float(np.median(sizes)), sizes[-1] - sizes[0]
        by = number(round(middle, 3)) if apart < 5e-3 else f"{number(sizes[0])} to {number(sizes[-1])}"
        word = "ahead of" if np.median(offsets) > 0 else "behind"
        if middle > 86400:  # such as epoch time and the start of a run
            lines.append(f"The logs of {first} and {second} use different clocks, more than a day apart. Ignored.")
        else:
            lines.append(f"The clock of the {first} is {by} s {word} that of the {second}. This is not a delay.")
    for side, alone in ((first, pairing.first_alone), (second, pairing.second_alone)):
        lines += [f"Recording {name} of the {side} has no partner: {why}." for name, why in alone]
    return lines


def _listed(names: Sequence[str], separator: str = ", ") -> str:
    more = len(names) - _LISTED
    return separator.join(names[:_LISTED]) + (f"{separator}and {more} more" if more > 0 else "")


def _of_ties(pairing: Pairing, first: str, second: str) -> list[str]:
    lines = []
    for side, groups in ((first, pairing.repeated[0]), (second, pairing.repeated[1])):
        words = _listed([", ".join(group) for group in groups], "; ")
        if groups:
            lines.append(
                f"Several recordings of the {side} have the same command ({words}) and were paired by their responses."
            )
    for name, partner, others in pairing.undecided[:_LISTED]:
        lines.append(
            f"{name} fits {_listed(others)} as well as {partner}: commands and responses are equal within the noise."
        )
    return lines


def _of_offsets(pairing: Pairing, first: str, second: str) -> list[str]:
    if not any(pairing.offsets):
        return []
    a = pairing.pairs[0].first
    kinds = zip(("commands", "outputs"), pairing.offsets, (a.voltage_unit, a.displacement_unit), strict=True)
    constants = ", ".join(f"{word} {number(float(from_base(v, unit)), 4)} {unit}" for word, v, unit in kinds if v)
    return [
        f"The log of the {first} has a constant offset beside that of the {second} ({constants}), which was "
        "subtracted. This is not a difference."
    ]


def _of_signs(pairing: Pairing, second: str) -> list[str]:
    signals = ("command", "input-scale"), ("output", "output-scale")
    mirrored = [names for names, turned in zip(signals, pairing.mirrored, strict=True) if turned]
    if not mirrored or not pairing.pairs:
        return []
    what, keys = zip(*mirrored, strict=True)
    rho = min(p.correlation for p in pairing.pairs)
    words = f" (correlation of the commands {rho:.3f})" if "command" in what else ""
    return [
        f"The {' and '.join(what)} of the {second} have the opposite sign (a mirrored axis{words}) and were inverted "
        f"for this comparison. To invert them in every command, put {' and '.join(f'{key} = -1' for key in keys)} "
        f'below ["*"] in the pitp.toml of one set (options: {" ".join(f"--{key} -1" for key in keys)}).'
    ]
