"""Read channels of LabVIEW's TDMS files (extra `labview`), each with its own clock if it is a waveform."""

from pathlib import Path
from typing import Any

import numpy as np

from ....common.errors import cleaned
from ..guard import check_columns
from ..options import ReadOptions
from ..table import Parts, array_table

kind, remedy = "a TDMS file", "export it from LabVIEW again"
suffixes = (".tdms",)
begins = (b"TDSm",)


def tables(path: Path, options: ReadOptions) -> Parts:
    """Return the channels of a LabVIEW TDMS file by group, each with its own clock if it is a waveform."""
    from nptdms import TdmsFile

    groups = [group for group in TdmsFile.read(path).groups() if group.channels()]
    split, parts = options.split_by == "group" or len(groups) == 1, []
    check_columns(sum(len(group.channels()) for group in groups), cleaned(path))
    for chosen in [[group] for group in groups] if split else [groups]:
        named = {c.name if split else f"{c.group_name}/{c.name}": c for group in chosen for c in group.channels()}
        clocks = {name: _waveform(c.properties) for name, c in named.items() if c.properties.get("wf_increment")}
        beside = {name: str(c.properties.get("unit_string") or "") for name, c in named.items()}
        stored = {name: (lambda c=c: c[:]) for name, c in named.items()}
        parts.append([array_table(path, stored, "TDMS file", beside=beside, clocks=clocks, part=chosen[0].name)])
    return parts


def _waveform(properties: Any) -> tuple[float, float]:
    start = properties.get("wf_start_time")
    begin = 0.0 if start is None else float((np.datetime64(start) - np.datetime64(0, "s")) / np.timedelta64(1, "s"))
    return begin + float(properties.get("wf_start_offset") or 0), float(properties["wf_increment"])
