"""One free-run simulator for every hypothesis: effects are slots of one parameter vector, each with a value for "off".

    a_0 x + a_1 x' + a_2 x'' = F c(x) - f(x, x', z),   F = map(V) / force scale,   y = sensor(x)

The linear part is exact for a force that runs linearly over a step, (x, v)+ = E (x, v) + b F_0 + d (F_1 - F_0), for any
order up to two, damped or not, with a spring or without (a_0 = 0). The other forces act at the middle of the step,
linearly implicit along their own tangent: f = f(x_m, v_m) / (1 + f' b_x / 2 + f'_v b_x / h). Dry friction takes what
stops the motion within the step and no more than its level. Memories advance exactly for x linear over a step. An
integrator with numerical damping (0.04 at 20 samples a period) once decided 5 of 18 outcomes.

Lanes (parameters beside a record) are columns of flat arrays; blocks of them run under one compiled program.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

WIDTHS, CHUNK, THREADS = (32, 256), 256, 2  # lanes a block, steps a call, blocks at a time
FAR = 1e4  # scaled displacement from which a run has diverged
_NEVER = 1e30
# slots whose forces take exponentials or many states: lanes without any run in a program of half the cost
_COSTLY = (
    "play1 play2 play3 play4 stretch_exp tanh expo sine root mullins drift bouc plays rise dry_speed drive_bouc bend"
).split()

# name: (value that switches it off, whether it is fitted by its logarithm)
SLOTS: dict[str, tuple[float, bool]] = {
    "a0": (0.0, True), "a1": (0.0, True), "a2": (0.0, True), "delay": (0.0, True),
    "rc": (0.0, True), "slew": (_NEVER, True), "clip": (_NEVER, True), "offset": (0.0, False), "dead": (0.0, True),
    "charge": (0.0, False), "charge_tau": (1.0, True), "saturation": (0.0, True), "play1": (0.0, False),
    "play2": (0.0, False), "play3": (0.0, False), "play4": (0.0, False), "play_range": (1.0, True),
    "stretch": (0.0, False), "stretch_exp": (0.0, False), "k2": (0.0, False), "k3": (0.0, False), "k5": (0.0, False),
    "reach": (1.0, True), "gent": (0.0, True), "tanh": (0.0, True),
    "expo": (0.0, False), "sine": (0.0, True), "root": (0.0, False), "stop": (0.0, True), "stop_at": (1.0, False),
    "low_stop": (0.0, True), "low_stop_at": (-1.0, False), "mullins": (0.0, False), "mullins_length": (1.0, True),
    "drift": (0.0, False), "drift_time": (1.0, True), "branch": (0.0, False), "branch_tau": (1.0, True),
    "branch2": (0.0, False), "branch2_tau": (1.0, True), "bouc": (0.0, False), "yield": (1.0, True),
    "gamma": (0.0, False), "plays": (0.0, True), "plays_width": (1.0, True), "drag": (0.0, True), "dry": (0.0, True),
    "dry_speed": (0.0, True), "drive_bouc": (0.0, False), "drive_yield": (1.0, True), "rise": (0.0, True),
    "rise_speed": (1.0, True), "dry_load": (0.0, True), "place_damping": (0.0, False), "place_damping2": (0.0, False),
    "field_damping": (0.0, False), "slack": (0.0, True), "mode_gain": (0.0, False), "mode_force": (0.0, True),
    "mode_w": (1.0, True), "mode_zeta": (0.1, True), "backlash": (0.0, True), "coast": (0.0, True), "lag": (0.0, True),
    "filter": (0.0, True), "filter_zeta": (1.0, True), "gain": (0.0, False), "s2": (0.0, False), "s3": (0.0, False),
    "fold": (0.0, False), "bend": (0.0, True),
}  # fmt: skip
NAMES = tuple(SLOTS)
INDEX = {name: k for k, name in enumerate(NAMES)}
OFF = np.array([off for off, _ in SLOTS.values()])
LOGARITHM = np.array([log for _, log in SLOTS.values()])

HIGHEST = {"mode_zeta": 0.5}  # an overdamped second mode is a relaxation or a delay by another name

_CONSTANTS = (
    "e11 e12 e21 e22 bx dx bv dv second h a0 a1 rc_keep rc_ramp slew clip offset dead charge q_keep q_ramp "
    "saturation play1 play2 play3 play4 play_range force stretch stretch_exp k2 k3 k5 reach "
    "gent tanh expo sine root stop stop_at low_stop low_stop_at mullins mullins_length drift drift_time age reached "
    "branch z_keep z_ramp z_half branch2 y_keep y_ramp y_half bouc yield gamma plays plays_width drag dry "
    "dry_speed drive_bouc drive_yield rise rise_speed dry_load place_damping place_damping2 field_damping slack "
    "mode_gain mode_force mode_w mode_zeta m11 m12 m21 m22 mb1 md1 mb2 md2 backlash coast coast_keep coast_way "
    "o_keep o_ramp lagged n11 n12 n21 n22 nb1 nd1 nb2 nd2 filtered gain s2 s3 fold bend "
).split()
_PLACE = {name: k for k, name in enumerate(_CONSTANTS)}
_STATES = "x v vm zd rc slewed q p1 p2 p3 p4 z z2 w b1 b2 b3 b4 most my mv play pv lag fy fv".split()
_PLAYS, _DRIVE_PLAYS = (0.15, 0.4, 1.0, 2.2), (0.04, 0.125, 0.25, 0.4)


@dataclass(frozen=True)
class Film:
    """The force of a record before it was thinned, for its mean around any instant.

    Attributes:
        impulse: its integral up to every sample, V^2 s or V s, shape (samples,).
        dt, first: s, between samples; of the first one after the first thinned one.
        window: s, over which it is averaged.
        edges: the force before and after the record.
    """

    impulse: np.ndarray
    dt: float
    first: float
    window: float
    edges: tuple[float, float]

    def force(self, time: np.ndarray) -> np.ndarray:
        """Mean force around instants (s after the first thinned sample), shape (T,)."""
        low, high = (self._until(time + half) for half in (-self.window / 2, self.window / 2))
        return (high - low) / self.window

    def _until(self, time: np.ndarray) -> np.ndarray:
        place, last = (time - self.first) / self.dt, len(self.impulse) - 1
        inside = np.interp(place, np.arange(last + 1), self.impulse)
        early, late = np.minimum(place, 0.0), np.maximum(place - last, 0.0)
        return inside + self.dt * (self.edges[0] * early + self.edges[1] * late)


@dataclass(frozen=True)
class Drive:
    """What a simulation reads of one record: inputs at every sample (V), step (s), and how it begins.

    Attributes:
        voltage: shape (T,).
        dt: s.
        start: scaled (x, v) at the first sample, as the data show it.
        age: of the session, s.
        before: V, what was played before the first sample; None: the same as there.
        jump: s, when the drive goes from there to its first sample: 0, or half a sample earlier where it holds.
        film: the drive before it was thinned; None: these samples are all there is.
        reached: largest scaled |x| of the session before this record.
    """

    voltage: np.ndarray
    dt: float
    start: tuple[float, float]
    age: float = 0.0
    before: float | None = None
    jump: float = 0.0
    film: Film | None = None
    reached: float = 0.0


@dataclass(frozen=True)
class Simulator:
    """Free runs of parameter vectors beside records.

    Attributes:
        drives: one per record.
        square: whether F = V^2 (else V).
        force_scale: of F.
        substeps: steps a sample.
        devices: blocks run on these in turn; none: on the default one.
    """

    drives: tuple[Drive, ...]
    square: bool
    force_scale: float
    substeps: int
    devices: tuple = ()

    def run(self, slots: np.ndarray, records: Sequence[int], starts: np.ndarray) -> list[np.ndarray]:
        """Scaled outputs (T,) of slots (lanes, slots) beside a record and from a start (x, v) each; nan if diverged."""
        places = np.asarray(records, int)
        costly = (slots[:, [INDEX[k] for k in _COSTLY]] != OFF[[INDEX[k] for k in _COSTLY]]).any(1)
        steps = np.array([len(d.voltage) for d in self.drives])[places]
        # alike ones side by side: blocks then share lengths, delays and the cheap program
        order = np.lexsort((slots[:, INDEX["delay"]], places, -steps, costly))
        blocks, place = [], 0
        while place < len(order):
            mixed = costly[order[place]]
            count = int(np.searchsorted(costly[order], mixed, "right")) - place
            width = WIDTHS[0] if count <= 2 * WIDTHS[0] else WIDTHS[1]
            blocks.append((order[place : place + min(count, width)], width, bool(mixed)))
            place += min(count, width)
        outputs: list = [None] * len(records)

        def run(numbered):
            k, (block, width, mixed) = numbered
            with jax.default_device(self.devices[k % len(self.devices)] if self.devices else None):
                return self._block(slots[block], places[block], starts[block], width, mixed)

        with ThreadPoolExecutor(max(THREADS, len(self.devices))) as pool:
            runs = pool.map(run, enumerate(blocks))
            for (block, _, _), rows in zip(blocks, runs, strict=True):
                for k, row in zip(block, rows, strict=True):
                    outputs[k] = row
        return outputs

    def _block(self, slots, records, starts, width: int, costly: bool) -> list[np.ndarray]:
        lanes = len(records)
        # copies of the last lane fill the block: programs have few widths
        fill = np.concatenate([np.arange(lanes), np.full(width - lanes, lanes - 1)])
        slots, records, starts = slots[fill], records[fill], starts[fill]
        sizes = [len(self.drives[r].voltage) for r in records]
        steps = -(-max(sizes) * self.substeps // CHUNK) * CHUNK
        inputs = self._inputs(slots, records, steps)
        constants = self._constants(slots, records)
        played = [self.drives[r].before for r in records]
        before = np.array([inputs[0, k] if p is None else p for k, p in enumerate(played)], float)
        program = self.square, costly
        with jax.enable_x64(True):
            state, pieces = _begin(self.square, constants, before, inputs[0], starts.T), []
            for first in range(0, steps, CHUNK):
                state, y = _advance(*program, constants, state, inputs[first : first + CHUNK + 1], float(first))
                pieces.append(np.asarray(y))
        y = np.concatenate(pieces)[:: self.substeps]
        return [y[: sizes[k], k] for k in range(lanes)]

    def _inputs(self, slots: np.ndarray, records: np.ndarray, steps: int) -> np.ndarray:
        """Delayed input at every step's ends, shape (steps + 1, lanes); its force runs straight between nodes."""
        # one delayed input for all lanes that share record and delay
        pairs, which = np.unique(np.stack([records, slots[:, INDEX["delay"]]], 1), axis=0, return_inverse=True)
        place, columns = np.arange(steps + 1) / self.substeps, []
        for record, delay in pairs:
            drive = self.drives[int(record)]
            if drive.film is not None:
                force = drive.film.force(place * drive.dt - delay)
                columns.append(root(force) if self.square else force)
                continue
            force = drive.voltage * np.abs(drive.voltage) if self.square else drive.voltage
            column = np.interp(place - delay / drive.dt, np.arange(len(force)), force)
            column = root(column) if self.square else column
            columns.append(column if drive.before is None else self._jumped(column, drive, delay))
        return np.ascontiguousarray(np.stack(columns, 1)[:, which.ravel()])

    def _jumped(self, column: np.ndarray, drive: Drive, delay: float) -> np.ndarray:
        """A delayed input with what was played before its first sample.

        Every step's end has the mean over half a step on either side (over one, at the first), so that the area under
        the force does not depend on where within a step the jump falls.
        """
        steps = max((delay + drive.jump) / drive.dt * self.substeps, 0.0)
        place = np.arange(len(column)) - steps
        # part of the step behind the jump
        share = np.clip(place + 0.5, 0.0, 1.0)
        share[0] = np.clip(1 - 2 * steps, 0.0, 1.0)
        before = float(drive.before or 0.0)
        return before + (column - before) * (np.sqrt(share) if self.square and not before else share)

    def _constants(self, slots: np.ndarray, records: np.ndarray) -> np.ndarray:
        s = dict(zip(NAMES, slots.T, strict=True))
        h = np.array([self.drives[r].dt for r in records]) / self.substeps
        c = {name: s[name] for name in _CONSTANTS if name in s}
        second = s["a2"] > 0
        e, b, d = step_response(s["a0"], s["a1"], s["a2"], h)
        c |= {"e11": e[:, 0, 0], "e12": e[:, 0, 1], "e21": e[:, 1, 0], "e22": e[:, 1, 1]}
        c |= {"bx": b[:, 0], "bv": b[:, 1], "dx": d[:, 0], "dv": d[:, 1], "second": second, "h": h}
        c["force"] = np.full(len(h), 1 / self.force_scale)
        c["age"], c["reached"] = (np.array([getattr(self.drives[r], k) for r in records]) for k in ("age", "reached"))
        for name, tau in (
            ("rc", s["rc"]),
            ("q", s["charge_tau"]),
            ("z", s["branch_tau"]),
            ("y", s["branch2_tau"]),
            ("o", s["lag"]),
        ):
            c[f"{name}_keep"], c[f"{name}_ramp"] = _lag(tau, h)
        c["z_half"], c["y_half"] = (-np.expm1(-h / 2 / s[k]) for k in ("branch_tau", "branch2_tau"))
        for name, w, zeta in (
            ("m", s["mode_w"], s["mode_zeta"]),
            ("n", 1 / np.maximum(s["filter"], 1e-9), s["filter_zeta"]),
        ):
            e, b, d = step_response(np.ones_like(h), 2 * zeta / w, 1 / w**2, h)
            c |= {f"{name}{i + 1}{j + 1}": e[:, i, j] for i in (0, 1) for j in (0, 1)}
            c |= {f"{name}b{i + 1}": b[:, i] for i in (0, 1)} | {f"{name}d{i + 1}": d[:, i] for i in (0, 1)}
        slowed = np.exp(-np.minimum(s["coast"] * h, 700))
        c["coast_keep"], c["coast_way"] = slowed, (1 - slowed) / np.maximum(s["coast"], 1e-300)
        c["lagged"], c["filtered"] = s["lag"] > 0, s["filter"] > 0
        c["gamma"] = 1.5 * np.tanh(s["gamma"] / 1.5)  # unbounded it is a saturating spring of any shape
        return np.stack([np.asarray(c[name], float) for name in _CONSTANTS])


def root(force: np.ndarray) -> np.ndarray:
    """V of V|V|."""
    return np.sign(force) * np.sqrt(np.abs(force))


def _lag(tau: np.ndarray, h: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(keep, ramp) of tau z' = w - z over h for w linear: z+ = keep z + (ramp - keep) w_0 + (1 - ramp) w_1."""
    # a time constant of zero: the lag follows at once
    r = h / np.maximum(tau, 1e-12)
    keep = np.exp(-np.minimum(r, 700))
    return keep, -np.expm1(-np.minimum(r, 700)) / np.maximum(r, 1e-300) * (r < 1e9) * (tau > 0)


def step_response(a0, a1, a2, h) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """E, b and d of (x, v)+ = E (x, v) + b F_0 + d (F_1 - F_0) for a_0 x + a_1 x' + a_2 x'' = F, per lane.

    The exponential of [[A, B, 0], [0, 0, 1], [0, 0, 0]] by scaling and squaring; a_2 = 0: order 1, v is not used.
    """
    second = a2 > 0
    m = np.zeros((len(h), 4, 4))
    m[:, 0, 1] = np.where(second, h, 0.0)
    low = np.where(second, np.where(second, a2, 1.0), np.maximum(a1, 1e-300))
    row = np.where(second, 1, 0)
    lanes = np.arange(len(h))
    # order one writes the first row, order two the second
    m[lanes, row, 0] = -a0 / low * h
    m[:, 1, 1] = np.where(second, -a1 / low * h, 0.0)
    m[lanes, row, 2] = h / low
    m[:, 2, 3] = 1.0
    # scaled to a norm below an eighth, where ten terms leave rounding
    norm = np.abs(m).sum(2).max(1)
    squarings = int(np.clip(np.ceil(np.log2(np.maximum(norm.max(), 1e-300))) + 3, 0, 60))
    m = m / 2.0**squarings
    total, term = np.eye(4) + m, m
    for k in range(2, 11):
        term = term @ m / k
        total = total + term
    for _ in range(squarings):
        total = total @ total
    return total[:, :2, :2], total[:, :2, 2], total[:, :2, 3]


def _bouc(z, dx, size, gamma):
    """Bouc-Wen, n = 1, exact while the signs hold: dz = dx (1 - (sgn dx + gamma sgn z) z / size); gamma 0 is Dahl."""
    q = (jnp.sign(dx) + gamma * jnp.sign(z)) / size
    r = jnp.clip(q * dx, -50.0, 50.0)
    small = jnp.abs(r) < 1e-6
    return z * jnp.exp(-r) + dx * jnp.where(small, 1 - r / 2, -jnp.expm1(-r) / jnp.where(small, 1.0, r))


def _follow(keep, ramp, z, before, after):
    return keep * z + (ramp - keep) * before + (1 - ramp) * after


def _film(square, c, rc, slewed, q, volts):
    """The scaled force behind the drive's effects."""
    v = jnp.clip(slewed, -c["clip"], c["clip"]) + c["offset"]
    v = jnp.where(c["dead"] > 0, jnp.sign(v) * jnp.maximum(jnp.abs(v) - c["dead"], 0.0), v)
    v = v + c["charge"] * q
    f = (v * v if square else v) * c["force"]
    return f / (1 + c["saturation"] * jnp.abs(f))


def _unpack(constants):
    return {name: constants[k] for name, k in _PLACE.items()}


@partial(jax.jit, static_argnums=0)
def _begin(square, constants, volts, first, start):
    """The state at a first sample: x and v as given, memories settled at what was played before it."""
    c = _unpack(constants)
    x, v = start
    # a drive that jumps at its first sample is there at once; only a lag or a slew limit keeps the film behind it
    film = jnp.where(c["rc_ramp"] > 0, volts, first)
    slewed = jnp.where(c["slew"] < _NEVER, volts, film)
    q = jnp.where(c["charge"] > 0, jnp.abs(volts), volts)
    zero = jnp.zeros_like(x)
    settled = {
        "x": x,
        "v": v,
        "vm": v,
        "zd": zero,
        "rc": film,
        "slewed": slewed,
        "q": q,
        "w": zero,
        "mv": zero,
        "pv": zero,
        "fv": zero,
    }
    settled |= {f"p{k}": volts for k in (1, 2, 3, 4)} | {"most": jnp.maximum(jnp.abs(x), c["reached"])}
    return tuple(settled.get(k, x) for k in _STATES)


@partial(jax.jit, static_argnums=(0, 1))
def _advance(square, costly, constants, state, volts, clock):
    c = _unpack(constants)
    h, second, weights = c["h"], c["second"] > 0, [c[f"play{k}"] for k in (1, 2, 3, 4)]

    def rarer(x, dx, time, s):
        """The forces that take exponentials or many states."""
        t, p, g = c["tanh"] * x, c["sine"] * x, jnp.clip(c["expo"] * x, -3.0, 6.0)
        near = [jnp.abs(r) < 0.03 for r in (t, p, g)]  # a ratio by its series
        t1, p1, g1 = (jnp.where(n, 1.0, r) for n, r in zip(near, (t, p, g), strict=True))
        tanh = jnp.where(near[0], -t * t / 3, jnp.tanh(t) / t1 - 1)
        sine = jnp.where(near[1], -p * p / 6, jnp.sin(p) / p1 - 1)
        expo = jnp.where(near[2], -g / 2 + g * g / 6, -jnp.expm1(-g) / g1 - 1)
        size = jnp.abs(x)
        shape = x * (0.97 * tanh + expo + sine)
        shape = shape + c["root"] * (jnp.sign(x) * jnp.sqrt(size * c["reach"] + 1e-12) - x)
        shape = shape + c["mullins"] * jnp.expm1(-jnp.maximum(s["most"], size) / c["mullins_length"]) * x
        shape = shape + c["drift"] * jnp.expm1(-(c["age"] + time) / c["drift_time"]) * x
        shape = shape + c["bouc"] * _bouc(s["w"], dx, c["yield"], c["gamma"])
        inside = [
            jnp.clip(s[f"b{k + 1}"], x - w * c["plays_width"], x + w * c["plays_width"]) for k, w in enumerate(_PLAYS)
        ]
        return shape + c["plays"] * (x - sum(inside) / 4)

    def forces(x, v, force, time, s):
        """The restoring and dissipative forces at the middle of a step but for dry friction."""
        dx = x - s["x"]
        r = c["gent"] * x
        top = 0.97**2
        square_ = jnp.minimum(r * r, top)
        gent = square_ / (1 - square_) + (r * r - square_) / (1 - top) ** 2
        shape = x * (c["k2"] * x + c["k3"] * x * x + c["k5"] * x**4 + gent)
        shape = shape + c["stop"] * jnp.maximum(x - c["stop_at"], 0.0)
        shape = shape - c["low_stop"] * jnp.maximum(c["low_stop_at"] - x, 0.0)
        shape = (
            shape + c["branch"] * (x - s["z"]) * (1 - c["z_half"]) + c["branch2"] * (x - s["z2"]) * (1 - c["y_half"])
        )
        # a mass on a spring and a damper: z = q + r q', q the oscillator of the sensor's mode, r = 2 zeta / omega,
        # f = kappa (x - z + r (x' - z')), q and q' at the middle of the step
        w, r = c["mode_w"], 2 * c["mode_zeta"] / c["mode_w"]
        q = s["my"] + h / 2 * s["mv"]
        q1 = s["mv"] + h / 2 * (w * w * (x - q) - r * w * w * s["mv"])
        q2 = w * w * (x - q - r * q1)
        shape = shape + c["mode_force"] * (x - q - r * q1 + r * (v - q1 - r * q2))
        shape = shape + rarer(x, dx, time, s) if costly else shape
        damping = (
            c["drag"] * jnp.abs(v) + c["place_damping"] * x + c["place_damping2"] * x * x + c["field_damping"] * force
        )
        return c["a0"] * shape + damping * v

    def smoothed(dry, level, free):
        """Level tanh(v / speed) at the end of the step, v = free - reply f: two Newton steps from its ramp."""
        reply, speed = jnp.where(second, c["bv"], c["bx"] / h), jnp.maximum(c["dry_speed"], 1e-30)
        most = reply * level
        v = jnp.where(jnp.abs(free) < speed + most, free * speed / (speed + most), free - jnp.sign(free) * most)
        for _ in range(2):
            t = jnp.tanh(v / speed)
            v = v - (v + most * t - free) / (1 + most / speed * (1 - t * t))
        return jnp.where(c["dry_speed"] > 0, level * jnp.tanh(v / speed), dry)

    def step(carry, ends):
        s: dict[str, Any] = dict(zip(_STATES, carry, strict=True))
        before, after, time = ends
        n = dict(s)
        # the drive: lag, then slew limit, then what is stored or remembered of it
        n["rc"] = _follow(c["rc_keep"], c["rc_ramp"], s["rc"], before, after)
        most = c["slew"] * h
        n["slewed"] = s["slewed"] + jnp.clip(n["rc"] - s["slewed"], -most, most)
        held = [jnp.where(c["charge"] > 0, jnp.abs(u), u) for u in (before, after)]
        n["q"] = _follow(c["q_keep"], c["q_ramp"], s["q"], *held)
        v0, v1 = u0, u1 = s["slewed"], n["slewed"]
        for k, (w, width) in enumerate(zip(weights, _DRIVE_PLAYS, strict=True) if costly else ()):
            half = width * c["play_range"]
            n[f"p{k + 1}"] = jnp.clip(s[f"p{k + 1}"], u1 - half, u1 + half)
            v0, v1 = v0 + w * (s[f"p{k + 1}"] - u0), v1 + w * (n[f"p{k + 1}"] - u1)
        if costly:
            n["zd"] = _bouc(s["zd"], h * (u0 + u1) / 2, c["drive_yield"], 0.0)
            v0, v1 = (v + c["drive_bouc"] * z / c["drive_yield"] for v, z in ((v0, s["zd"]), (v1, n["zd"])))
        p0 = _film(square, c, s["rc"], v0, s["q"], before)
        p1 = _film(square, c, n["rc"], v1, n["q"], after)
        # where the step will be half way, as at the end of the last one
        ahead = s["x"] + h / 2 * s["vm"]
        couple = jnp.maximum(1 + c["stretch"] * ahead, 0.05)
        couple = couple * jnp.exp(jnp.clip(c["stretch_exp"] * ahead, -8.0, 8.0)) if costly else couple
        p0, p1 = p0 * couple, p1 * couple
        # the linear plant's own step, exact for a force that runs straight
        x = c["e11"] * s["x"] + c["e12"] * s["v"] + c["bx"] * p0 + c["dx"] * (p1 - p0)
        v = c["e21"] * s["x"] + c["e22"] * s["v"] + c["bv"] * p0 + c["dv"] * (p1 - p0)
        middle, speed, push = (s["x"] + x) / 2, (x - s["x"]) / h, (p0 + p1) / 2
        # what else pulls, at the middle of that step, and how it answers to being moved
        f, slope = jax.jvp(lambda x, v: forces(x, v, push, time, s), (middle, speed), (c["bx"] / 2, c["bx"] / h))
        f = f / (1 + jnp.maximum(slope, -0.5))
        x, v = x - c["bx"] * f, v - c["bv"] * f
        # friction last: it takes what would stop the motion that all others leave
        level = c["dry"] * (1 + c["rise"] * jnp.exp(-((speed / c["rise_speed"]) ** 2)) if costly else 1.0)
        level = level + c["dry_load"] * c["a0"] * jnp.abs(middle)
        stops = jnp.where(second, v / jnp.where(second, c["bv"], 1.0), (x - s["x"]) / c["bx"])
        dry = jnp.clip(stops, -level, level)
        dry = smoothed(dry, level, jnp.where(second, v, (x - s["x"]) / h)) if costly else dry
        x, v = x - c["bx"] * dry, v - c["bv"] * dry
        # nothing pulls back faster than it falls
        least = s["v"] - h / jnp.maximum(c["slack"], 1e-30)
        falls = (v < least) & (c["slack"] > 0) & second
        x, v = jnp.where(falls, s["x"] + h / 2 * (s["v"] + least), x), jnp.where(falls, least, v)
        # nan compares false: it is lost, too
        lost = ~(jnp.abs(x) < FAR)
        n["x"], n["v"] = jnp.where(lost, FAR, x), jnp.where(lost, 0.0, v)
        x, past = n["x"], s["x"]
        n["vm"] = (x - past) / h
        n["z"] = _follow(c["z_keep"], c["z_ramp"], s["z"], past, x)
        n["z2"] = _follow(c["y_keep"], c["y_ramp"], s["z2"], past, x)
        if costly:
            n["w"] = _bouc(s["w"], x - past, c["yield"], c["gamma"])
            for k, w in enumerate(_PLAYS):
                n[f"b{k + 1}"] = jnp.clip(s[f"b{k + 1}"], x - w * c["plays_width"], x + w * c["plays_width"])
            n["most"] = jnp.maximum(s["most"], jnp.abs(x))
        # the sensor's side: a mode, backlash, lag and filter, one behind the other
        n["my"] = c["m11"] * s["my"] + c["m12"] * s["mv"] + c["mb1"] * past + c["md1"] * (x - past)
        n["mv"] = c["m21"] * s["my"] + c["m22"] * s["mv"] + c["mb2"] * past + c["md2"] * (x - past)
        old, new = past + c["mode_gain"] * (s["my"] - past), x + c["mode_gain"] * (n["my"] - x)
        alone = s["play"] + jnp.where(c["coast"] > 0, c["coast_way"] * s["pv"], 0.0)
        n["play"] = jnp.clip(alone, new - c["backlash"] / 2, new + c["backlash"] / 2)
        n["pv"] = jnp.where(n["play"] == alone, s["pv"] * c["coast_keep"], (new - old) / h)
        old, new = jnp.clip(s["play"], old - c["backlash"] / 2, old + c["backlash"] / 2), n["play"]
        n["lag"] = jnp.where(c["lagged"] > 0, _follow(c["o_keep"], c["o_ramp"], s["lag"], old, new), new)
        old, new = s["lag"], n["lag"]
        n["fy"] = c["n11"] * s["fy"] + c["n12"] * s["fv"] + c["nb1"] * old + c["nd1"] * (new - old)
        n["fv"] = c["n21"] * s["fy"] + c["n22"] * s["fv"] + c["nb2"] * old + c["nd2"] * (new - old)
        return tuple(n[k] for k in _STATES)

    def along(state, row):
        k, before, after = row
        lost = jnp.abs(state[0]) >= FAR
        y = jnp.where(c["filtered"] > 0, state[_STATES.index("fy")], state[_STATES.index("lag")])
        y = y * (1 + c["gain"] + c["s2"] * y + c["s3"] * y * y)
        y = jnp.where(c["fold"] != 0, jnp.abs(y), y)
        if costly:
            y = jnp.where(c["bend"] > 0, jnp.tanh(c["bend"] * y) / jnp.maximum(c["bend"], 1e-6), y)
        return step(state, (before, after, (k + 0.5) * h)), jnp.where(lost, jnp.nan, y)

    return jax.lax.scan(along, state, (clock + jnp.arange(len(volts) - 1), volts[:-1], volts[1:]))
