"""Parse the name of a column: its unit, and its role as time, input or output.

header -> (what is measured, unit, text in place of a unit) and a role by its words

Only ratios of the table are units: in `Field V/um`, `v_mm/s2` or `N/m` no part is the unit of the column.
"""

import re
import unicodedata
from dataclasses import dataclass

from ...common.units import kind_of, plain, spelt, written

_VOCABULARY = {
    "time": "t time zeit timestamp stamp unix epoch reltime abstime date datetime datum uhrzeit temps tiempo tempo "
    "elapsed clock millis micros x_value x_werte время 時間 时间 時刻",
    "input": "u v voltage volt volts spannung hochspannung tension voltaje drive hv input inputs in vin amplifier amp "
    "excitation eingang anregung actuation monitor command cmd control set setpoint desired des target reference ref "
    "goal soll sollwert consigne cons consigna demand duty pwm throttle ctrl action qfrc heater potential напряжение "
    "電圧 电压 電圧値",
    "output": "x y z d w q displacement disp position pos weg auslenkung verschiebung abstand hub laser stroke "
    "deflection distance output outputs out motion extension elongation height hoehe deplacement response lvdt sensor "
    "ausgang vout angle theta encoder qpos qvel measured actual ist istwert mesure mes feedback перемещение "
    "смещение 変位 位移",
}
_WORDS = {role: frozenset(words.split()) for role, words in _VOCABULARY.items()}
_COMMANDS = frozenset(
    "command cmd control set setpoint desired des goal target soll sollwert consigne cons consigna demand ctrl action "
    "duty pwm".split()
)  # a command even beside the word "position"
_TURNING = frozenset("angle theta encoder q qpos".split())
_PORTS = frozenset(
    "input inputs output outputs in out vin vout eingang ausgang".split()
)  # of the DAQ or of the actuator, which is unknown
_BRACKETS = re.compile(r"[(\[{<]\s*([^()\[\]{}<>]*?)\s*[)\]}>]")
_LAST = re.compile(r"^(.*\S)(?:\s*[_,:;-]\s*|\s+)(\S+)$")
_ROLE_OF = {"s": "time", "h": "time", "d": "time", "min": "time", "m": "output", "A": None, "N": None, "K": None}
_OWN = {
    "A": {"current", "strom", "i", "coil", "motor", "winding", "input", "output"},
    "N": {"force", "kraft", "f", "input", "output"},
    "K": {"temperature", "temp", "t"},
}  # fmt: skip
_OWN_FILES = re.compile(r"(input|output|target|predicted)_(\S+)")  # of files that pitp writes
_R_BRACKETS = re.compile(r"\.\.([^.\s]+)\.$")  # R makes `Weg..mm.` of `Weg (mm)`
_PHYSICAL = re.compile(r"[pnumckMG](m|s|V|A|N|Pa|g|Hz|W|J|C|F)|[smVAN]|Hz|Pa")  # units, never names of a quantity


@dataclass(frozen=True)
class Header:
    """A column name, parsed into quantity, unit and role.

    Attributes:
        stem: the measured quantity.
        unit: its unit, or None.
        unknown: text in place of a unit that is not a known unit, or None.
        words: of the stem, in lower case.
        role: "time", "input", "output", or None if its words give none or two.
    """

    stem: str
    unit: str | None
    unknown: str | None
    words: frozenset[str]
    role: str | None

    @property
    def commanded(self) -> bool:
        """Return whether a word of the name says command: `goal`, `target`, `setpoint`."""
        return bool(self.words & _COMMANDS)

    @property
    def clock_only(self) -> bool:
        """Return whether the name can only be that of a clock: `time`, but not `cycle time` or `latency`."""
        return bool(self.words) and self.words <= _WORDS["time"]

    @property
    def port_only(self) -> bool:
        """Return whether only words such as input or output, which may mean a DAQ's port, indicate the role."""
        return self.role is not None and (self.words & _WORDS[self.role]) <= _PORTS


def read_header(text: str) -> Header:
    """Parse a column header: `Weg [µm]`, `U/V`, `time_s`, `Time in ms`, `Field V/um`."""
    stem, unit, unknown = _parted(plain(text))
    words = _words(stem)
    if unit is not None:  # v may be a voltage or a velocity, t a time or a temperature
        words -= {"v": {"v"}, "t": {"t"}}.get(stem.lower(), frozenset()) - {
            {"voltage": "v", "time": "t"}.get(kind_of(unit) or "", "")
        }
    return Header(stem, unit, unknown, words, _role(words))


def _parted(text: str) -> tuple[str, str | None, str | None]:
    own = _OWN_FILES.fullmatch(text)
    if own and not spelt(own[2]) and written(own[2]):
        return own[1], own[2], None
    unknown, text = None, _R_BRACKETS.sub(r" (\1)", text)
    for bracket in _BRACKETS.finditer(text):
        inside = bracket[1]
        # `(in)` is an inch, the word before a unit is not
        inch = inside == "in" and text[: bracket.start()].strip() not in ("V", "I")  # V(in) is a node of SPICE
        unit = "inch" if inch else spelt(inside) or spelt(re.split(r"[,;]", inside)[0])
        unit = unit or {"C": "degC"}.get(inside)  # a bare C is a channel
        if unit:
            return (text[: bracket.start()] + text[bracket.end() :]).strip(), unit, None
        if not inside.isdecimal():  # position[2] is the third joint
            unknown = inside or unknown
    if unknown:
        # A logger's serial number may follow the unit: `HV, kV (LGR S/N: 10)`.
        bare = _BRACKETS.sub("", text).strip()
        stem, unit, _ = _parted(bare) if "," in bare else (text, None, None)
        return (stem, unit, None) if unit else (text, None, unknown)
    if (whole := spelt(text)) and len(text) > 1 and whole not in ("min", "h", "d"):
        return text, whole, None
    text = re.sub(r"\s*/\s*", "/", text)
    # the text after the last blank or underscore: `U/V`, `v_mm/s`
    last = re.split(r"[\s_,;:]+", text)[-1]
    if "/" in last:
        return _ratio(text, last)
    ending = _LAST.match(text)
    unit = spelt(ending[2]) if ending else None
    if not ending or not unit:
        return text, None, None
    stem = re.sub(r"(\s|^)in$", "", ending[1]).rstrip(" /_,:;-")
    said = stem != ending[1].rstrip(" /_,:;-") or text.lower().startswith("in ")
    if not said and unit in _ROLE_OF and len(ending[2]) == 1 + 2 * (unit == "min"):
        words = _words(stem)
        is_plausible = _role(words) == _ROLE_OF[unit] if _ROLE_OF[unit] else words & _OWN[unit]
        if unit == "m":  # also a commanded position, but theta_m is the angle of a motor
            is_plausible = (is_plausible or words & _COMMANDS) and not words & _TURNING
        if not is_plausible:
            return text, None, None  # `Channel A` is not a current
    return stem, unit, None


def _ratio(text: str, last: str) -> tuple[str, str | None, str | None]:
    """Parse a header that ends in `a/b`: a known unit, `quantity/unit`, or an unknown ratio."""
    if unit := spelt(last):
        return text.removesuffix(last).rstrip(" /_,:;-") or text, unit, None
    above, _, below = last.partition("/")
    unit, of = spelt(below), spelt(above)
    if _PHYSICAL.fullmatch(above) or (of is not None and len(above) > 1):
        return text, None, last
    if unit:
        return text.removesuffix(last) + above, unit, None
    parts = [spelt(part) for part in below.split("/")]
    return text, None, last if any(parts) and len(parts) > 1 else None


def _words(stem: str) -> frozenset[str]:
    # é as e, because names come with and without accents
    lower = "".join(c for c in unicodedata.normalize("NFKD", stem.lower()) if not unicodedata.combining(c))
    # digits and camel case separate words: `Voltage0`, `laserHead`
    parts = re.findall(r"[^\W\d_]+", re.sub(r"(?<=[a-z])(?=[A-Z])", " ", lower))
    words = {w for k, w in enumerate(parts) if len(w) > 1 or k == 0} | ({lower} & {"x_value"})
    # Chinese and Japanese have no blanks between words
    far_east = {w for known in _WORDS.values() for w in known if ord(w[0]) > 0x3000 and w in stem}
    return frozenset(words | far_east)


def roles_of(words: frozenset[str]) -> list[str]:
    """Return every role (time, input, output) that a word of a name indicates."""
    return [role for role, known in _WORDS.items() if words & known]


def _role(words: frozenset[str]) -> str | None:
    if "x_value" in words:
        return "time"
    # a commanded position is an input, though a position is an output
    if words & _COMMANDS:
        return "input"
    # `input displacement` indicates two roles, so none
    named = roles_of(words)
    return named[0] if len(named) == 1 else None
