"""Read logs of robots as columns: rosbag2 folders and MCAP files (extra `robot`).

message of a topic -> /topic.field[i], in SI    rows: the messages of the output's topic
u(t) = the last value sent at or before t        (a command holds until the next one)
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ....common.errors import cleaned
from ....method.signal.checks import sample
from ..guard import MAX_ENTRIES, check_columns, check_unfolded
from ..options import ReadOptions
from ..table import Column, Parts, Table

kind, remedy = "a robot log", "record it again"
suffixes = (".mcap",)
begins = (b"",)  # a folder has no first bytes, and the library refuses other files
_OWN_TOPICS = ("/rosout", "/parameter_events", "/clock", "/tf", "/tf_static")  # ROS's own, not signals of a machine
_UNITS = (  # of a field, by ROS's conventions (REP 103) and its standard messages
    (r"\.positions?\[\d+\]$", "rad"), (r"\.velocit(y|ies)\[\d+\]$", "rad/s"), (r"\.efforts?\[\d+\]$", "N m"),
    (r"\.(position|translation)\.[xyz]$", "m"), (r"\.linear\.[xyz]$", "m/s"), (r"\.force\.[xyz]$", "N"),
    (r"\.angular(_velocity)?\.[xyz]$", "rad/s"), (r"\.linear_acceleration\.[xyz]$", "m/s2"),
    (r"\.torque\.[xyz]$", "N m"),
)  # fmt: skip


def tables(path: Path, options: ReadOptions) -> Parts:
    """Return a rosbag2 folder or MCAP file as a table: a clock, and a column for every number of every topic."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    size = sum(file.stat().st_size for file in (path.iterdir() if path.is_dir() else [path]))
    rows: dict[str, list[tuple[float, float, dict[str, float]]]] = {}
    unfolded = 0
    with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as reader:
        connections = [c for c in reader.connections if _wanted(c.topic, options)]
        for connection, logged, raw in reader.messages(connections) if connections else ():
            unfolded += len(raw)
            check_unfolded(unfolded, size)
            message: Any = reader.deserialize(raw, connection.msgtype)
            values = dict(_numbers(message, connection.topic))
            rows.setdefault(connection.topic, []).append((1e-9 * logged, _stamp(message), values))
    return [[_topics(path, {topic: each for topic, each in rows.items() if any(v for _, _, v in each)})]]


def _wanted(topic: str, options: ReadOptions) -> bool:
    """Return whether to read a topic: those of the stated input and output, otherwise all except ROS's own."""
    said = (options.input_column, options.output_column)
    if all(said):
        return any(str(name).startswith(f"{topic}.") for name in said)
    return topic not in _OWN_TOPICS


def _stamp(message: Any) -> float:
    """Return the time stamp in a message's header, s; nan if it is missing or was never set."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    return np.nan if stamp is None or not (stamp.sec or stamp.nanosec) else stamp.sec + 1e-9 * stamp.nanosec


def _numbers(value: Any, place: str) -> Iterator[tuple[str, float]]:
    """Yield every number in a message with its path; headers, layouts and long arrays are skipped."""
    if isinstance(value, (np.ndarray, list)):
        for k, entry in enumerate(value if len(value) <= MAX_ENTRIES else ()):
            yield from _numbers(entry, f"{place}[{k}]")
    elif is_dataclass(value):
        for field in fields(value):
            if field.name not in ("header", "layout"):
                yield from _numbers(getattr(value, field.name), f"{place}.{field.name}")
    elif isinstance(value, (bool, int, float, np.number)):
        yield place, float(value)


def _topics(path: Path, rows: dict[str, list[tuple[float, float, dict[str, float]]]]) -> Table:
    """Join topics in one table; its rows are the messages of the last column that is loaded (the output)."""
    import pandas as pd

    # one clock for all topics: two would shift command against response
    unset = [topic for topic, each in rows.items() if np.isnan([stamp for _, stamp, _ in each]).any()]
    clocks = {topic: np.array([row[0 if unset else 1] for row in each]) for topic, each in rows.items()}
    values = {topic: pd.DataFrame([row[2] for row in each]) for topic, each in rows.items()}
    places = [("", ""), *((topic, name) for topic, frame in values.items() for name in frame)]
    check_columns(len(places))
    clock = f"log time ({cleaned(unset[0])} has no header.stamp)" if unset else "header.stamp"
    units = [next((unit for pattern, unit in _UNITS if re.search(pattern, name)), None) for _, name in places[1:]]
    columns = [Column(clock.partition(" (")[0], "s")]
    columns += [Column(cleaned(name), unit) for (_, name), unit in zip(places[1:], units, strict=True)]

    def load(asked: Sequence[int]) -> list[np.ndarray]:
        topics = [places[k][0] for k in asked if places[k][0]] or list(rows)[:1]
        begin = max(clocks[topic][0] for topic in topics)  # a command is unknown before its first message
        # the rows are those of the output, asked for last
        time = clocks[topics[-1]]
        time = time[time >= begin]
        # the last message at or before each row
        held = {topic: np.searchsorted(clocks[topic], time, side="right") - 1 for topic in topics}
        return [
            time if not name else values[topic][name].to_numpy()[held[topic]]
            for topic, name in map(places.__getitem__, asked)
        ]

    return Table(path, tuple(columns), load, sample, f"robot log, clock {clock}, commands held")
