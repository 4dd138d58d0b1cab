"""Write rounded numbers as text.

value +- stderr     two digits of the standard error if it begins with 1, otherwise one; the value to the same digit
"""

import math

_DIGITS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def number(value: float | None, digits: int = 4) -> str:
    """Write a number for the terminal, in ASCII; a dash if it is missing."""
    return "-" if value is None or value != value else f"{value:.{digits}g}"


def finite(value) -> float | None:
    """Return a number as a float; None, which is unknown, if it is nan or infinite."""
    return float(value) if math.isfinite(value) else None


def short(value: float, digits: int = 2) -> str:
    """Write a number with this many digits, or as an integer from 100 on."""
    return f"{value:.0f}" if value >= 100 else f"{value:.{digits}g}"


def figure(value: float | None, digits: int = 3) -> str:
    """Write a number with this many digits and powers of ten as ·10ⁿ; a dash if it is missing."""
    if value is None or not math.isfinite(value):
        return "–"
    if value and not 1e-3 <= abs(value) < 1e6:
        head, power = f"{value:.{digits - 1}e}".split("e")
        return f"{head}·10{str(int(power)).translate(_DIGITS)}".replace("-", "−")
    places = digits - 1 - _power(value) if value else 0
    return f"{round(value, places):.{max(places, 0)}f}".replace("-", "−")


def percent(share: float | None) -> str:
    """Write a fraction as a percentage, without decimals except between 98.5 and 100 %."""
    if share is None or not math.isfinite(share):
        return "–"
    text = f"{100 * share:.1f}" if 0.985 < share < 0.9995 else f"{100 * share:.0f}"
    return f"{'0' if text == '-0' else text.replace('-', '−')} %"


def interval(low: float, high: float) -> str:
    """Write a 95 % interval of fractions in %; with one more digit if both ends would look equal."""
    ends = [percent(low), percent(high)]
    if ends[0] == ends[1] and low < high:
        ends = [f"{100 * end:.1f} %".replace("-", "−") for end in (low, high)]
    return " to ".join(ends)


def of_range(value: float | None) -> str:
    """Write an error in % of range."""
    return f"{figure(value, 2 if value is not None and value < 10 else 3)} %"


def with_error(value: float, stderr: float | None, unit: str) -> str:
    """Write a value with its standard error, `0.4781 ± 0.0002 ms`; without ± if the error is unknown."""
    if not stderr or not math.isfinite(stderr):
        return f"{figure(value)} {unit}".strip()
    texts, scaled = _to_digits_of(stderr, value, stderr)
    text = " ± ".join(texts)
    return f"{f'({text}){scaled}' if scaled else text} {unit}".strip()


def with_interval(value: float, low: float, high: float, unit: str) -> str:
    """Write a value with its 95 % interval, `0.4781 s (0.4777 to 0.4785)`, rounded to what the interval determines."""
    width = (high - low) / 4
    if not width or not math.isfinite(width):
        return f"{figure(value)} {unit}".strip()
    texts, scaled = _to_digits_of(width, value, low, high)
    return f"{f'{texts[0]}{scaled} {unit}'.strip()} ({texts[1]} to {texts[2]}{scaled})"


def _to_digits_of(error: float, *values: float) -> tuple[list[str], str]:
    """Round values to the digits that an error determines; return their texts, and the power of ten of all of them."""
    size = max(map(abs, values))
    power = _power(size) if not 1e-3 <= size < 1e6 else 0
    error = error / 10.0**power
    lead = _power(error)
    places = -lead + (error / 10.0**lead < 2)
    texts = [f"{round(v / 10.0**power, places):.{max(places, 0)}f}".replace("-", "−") for v in values]
    return texts, f"·10{str(power).translate(_DIGITS)}" if power else ""


def rounded_up(value: float) -> float:
    """Round a positive number up to two digits."""
    unit = 10.0 ** (_power(value) - 1)
    return float(f"{math.ceil(value / unit * (1 - 1e-9)) * unit:.2g}")


def shown_unit(unit: str) -> str:
    """Write a unit with typographic characters: µm for um, ² for ^2."""
    return unit.replace("um", "µm").replace("^2", "²").replace("^3", "³")


def _power(value: float) -> int:
    return math.floor(math.log10(abs(value)))
