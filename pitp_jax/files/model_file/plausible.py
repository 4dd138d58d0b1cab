"""Check the numbers of a model file, because an intact digest does not prove that they make a model.

dt > 0,   scales > 0,   polarity = +-1,   all finite except upper limits and bounds;   few parts of reasonable size
"""

import math

import numpy as np

from ...common.errors import BadInput
from ...common.units import INPUT_UNITS, OUTPUT_UNITS
from ..containers.refusal import shortened

# far above any model, because a damaged size would allocate all memory
_LARGEST = {"depth": 64, "outputs": 64, "tokens": 64, "order": 16, "memories": 256, "size": 256, "lags": 256}
_LARGEST_SIZE = 4096  # of any other kind: no part is near this


def header_problems(header: dict) -> list[str]:
    """Return a text for every impossible number in a header.

    Raises:
        KeyError, TypeError, ValueError: entries are missing or of another kind.
    """
    domain, origin, output, scales = (header[name] for name in ("domain", "origin", "output", "scales"))
    low, high = domain["voltage_range"]
    # each key is the text shown to the user; all that fail come in one line
    checks = {
        f"order {header['order']!r}": 1 <= header["order"] <= _LARGEST["order"],
        f"hold {header['hold']!r}": header["hold"] in ("foh", "zoh", "bandlimited"),
        f"substeps {header['substeps']!r}": 1 <= header["substeps"] <= _LARGEST_SIZE,
        f"{len(header['effects'])} effects": len(header["effects"]) <= 64,
        f"{len(header['leaves'])} arrays": len(header["leaves"]) <= _LARGEST_SIZE,
        f"dt {domain['dt']!r}": _positive(domain["dt"]),
        f"scales of the state {scales['state']!r}": bool(scales["state"]) and all(map(_positive, scales["state"])),
        f"scale of the force {scales['force']!r}": _positive(scales["force"]),
        f"sections {scales['sections']!r}": all(math.isfinite(s) and s != 0 for s in scales["sections"]),
        f"offset {output['offset']!r}": math.isfinite(output["offset"]),
        f"polarity {output['polarity']!r}": abs(output["polarity"]) == 1,
        f"voltage range {low!r} to {high!r}": math.isfinite(low) and low <= high,  # the upper end may be unknown
        f"slew {domain['slew']!r}": domain["slew"] >= 0,
        f"region {domain['region']!r}": all(a <= b for a, b in domain["region"]),
        f"clock {domain['clock']!r}": math.isfinite(domain["clock"]),
        f"noise {domain.get('noise')!r}": 0 <= domain.get("noise", 0.0) < math.inf,
        f"unit {origin['displacement_unit']!r}": origin["displacement_unit"] in OUTPUT_UNITS,
        f"unit {origin['voltage_unit']!r}": origin["voltage_unit"] in INPUT_UNITS,
    }
    checks |= _history(origin)
    for part in (header["encoder"], header["memory"], header["drive"], header["input_map"], *header["effects"][:64]):
        for key, value in part.items():
            # True is an int in Python and would be a size of 1
            most = _LARGEST.get(key, _LARGEST_SIZE if isinstance(value, int) else math.inf)
            good = type(value) in (int, float) and math.isfinite(value) and 0 <= value <= most
            # an adapted encoder is one `of` another
            fits = good or key in ("name", "of", "module")
            checks[f"{part['name']}: {key} {value!r}"] = fits and not (key == "horizon" and value == 0)
    long = header.get("long_record")
    if long is not None:
        checks[f"dt of the long record {long['dt']!r}"] = _positive(long["dt"])
    return [name for name, good in checks.items() if not good]


def _history(origin: dict) -> dict[str, bool]:
    """Return, for each kind of entry in the origin, whether all entries have the form that pitp writes."""
    training, adapted, lineage = origin["training"] or {}, origin["adapted"], origin["lineage"]
    names = (*origin["identified_on"], *origin["remarks"], *training.get("records", ()))
    numbers = [training.get(key) or 0.0 for key in ("seconds", "creep_held_to_s", "second_mass_hz")]
    changes = [change for entry in adapted for change in entry["changed"].values()]
    sources = [record for entry in lineage for record in entry.get("records", ())]
    excited = [row for name in ("excited_input", "excited_output", "errors") for row in origin.get(name, ())]
    return {
        "tables by frequency whose rows are not three numbers": all(
            len(row) == 3 and row[0] > 0 and all(math.isfinite(v) and v >= 0 for v in row) for row in excited
        ),
        "names of records that are no text": all(isinstance(name, str) for name in names),
        "seconds that are no number": all(isinstance(number, (int, float)) for number in numbers),
        "errors of recordings left out that are no numbers": all(
            e is None or (math.isfinite(e) and e >= 0) for e in (training.get("left_out_errors") or {}).values()
        ),
        "stages that are no table": all(isinstance(stage, dict) for stage in training.get("history", ())),
        "changes without factor and interval": all(
            math.isfinite(c["factor"]) and all(map(math.isfinite, c["ci95"])) and len(c["ci95"]) == 2 for c in changes
        ),
        "versions that are no table": all(isinstance(entry.get("versions", {}), dict) for entry in lineage),
        "sources without name and sum": all({"name", "sha256"} <= set(source) for source in sources),
    }


def leaf_problems(names: list[str], arrays: list[np.ndarray]) -> list[str]:
    """Return a text for every array that is not finite, and for a highest coefficient of zero."""
    problems = []
    for name, array in zip(names, arrays, strict=True):
        good = not np.isnan(array).any() if name.endswith(".bounds") else np.isfinite(array).all()
        if not good:
            problems.append(f"{name} holds values that are not finite")
        # the equation is solved for the highest derivative, so a 0 there divides every step by zero
        elif name == ".coefficients" and array.size and array.reshape(-1)[-1] == 0:
            problems.append("its highest coefficient is 0")
    return problems


def _positive(value) -> bool:
    return math.isfinite(value) and value > 0


def refuse(problems: list[str]) -> None:
    """Refuse a file with these problems.

    Raises:
        BadInput: there is at least one.
    """
    if problems:
        # short and few, because the values are a stranger's text on the user's terminal
        listed = "; ".join(shortened(problem, 80) for problem in problems[:8])
        raise BadInput(f"not a usable model file ({listed}); write it again with pitp")
