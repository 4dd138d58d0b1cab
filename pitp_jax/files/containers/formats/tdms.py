"""Read channels of LabVIEW's TDMS files (extra `labview`); the clock of a waveform is a column before it."""

from pathlib import Path
from typing import Any

import numpy as np

from ..guard import check_columns
from ..options import ReadOptions
from ..table import Parts, Stored, array_table

kind, remedy = "a TDMS file", "export it from LabVIEW again"
suffixes = (".tdms",)
begins = (b"TDSm",)


def tables(path: Path, options: ReadOptions) -> Parts:
    """Return the channels of a LabVIEW TDMS file by group; waveforms of one clock stand behind it."""
    from nptdms import TdmsFile

    groups = [group for group in TdmsFile.read(path).groups() if group.channels()]
    split, parts = options.split_by == "group" or len(groups) == 1, []
    check_columns(sum(len(group.channels()) for group in groups))
    for chosen in [[group] for group in groups] if split else [groups]:
        named = {c.name if split else f"{c.group_name}/{c.name}": c for group in chosen for c in group.channels()}
        stored, clock = [], None
        for name, c in sorted(named.items(), key=lambda item: bool(item[1].properties.get("wf_increment"))):
            if c.properties.get("wf_increment") and clock != (clock := (*_waveform(c.properties), len(c))):
                stored.append(Stored("time", lambda c=clock: c[0] + c[1] * np.arange(c[2]), "s"))
            stored.append(Stored(name, lambda c=c: c[:], c.properties.get("unit_string")))
        parts.append([array_table(path, stored, "TDMS file", chosen[0].name)])
    return parts


def _waveform(properties: Any) -> tuple[float, float]:
    """Return the time of the first sample and the step, s."""
    start = properties.get("wf_start_time")
    begin = 0.0 if start is None else float((np.datetime64(start) - np.datetime64(0, "s")) / np.timedelta64(1, "s"))
    return begin + float(properties.get("wf_start_offset") or 0), float(properties["wf_increment"])
