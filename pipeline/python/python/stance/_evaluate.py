"""Scores of edits."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from . import _native
from ._dataset import local_path
from ._native import Motion

_Path = str | os.PathLike[str]
_Takes = Motion | Sequence[Motion]


class Scores:
    """Scores of systems: ``rows``, one for each system, task and metric, and the tables as text (``print(scores)``)."""

    def __init__(self, rows: list[dict[str, Any]], text: str) -> None:
        self.rows = rows
        self.text = text

    def __str__(self) -> str:
        return self.text

    def __len__(self) -> int:
        return len(self.rows)

    def value(self, system: str, metric: str, task: str | None = None) -> float:
        """The mean of a metric; without ``task``, that of the first task."""
        for row in self.rows:
            if (row["system"], row["metric"]) == (system, metric) and task in (None, row["task"]):
                return row["mean"]
        raise KeyError(f"no score of {system!r}, {metric!r}, {task!r}")

    def table(self) -> list[dict[str, Any]]:
        """A row for each task and system: ``n``, each metric, and half the width of its 95 % interval as ``METRIC ±``."""
        table: dict[tuple[str, str], dict[str, Any]] = {}
        for row in self.rows:
            key = (row["task"], row["system"])
            line = table.setdefault(key, {"task": row["task"], "system": row["system"], "n": row["n"]})
            line[row["metric"]] = row["mean"]
            line[f"{row['metric']} ±"] = row["ci95"]
        columns = list(dict.fromkeys(column for line in table.values() for column in line))
        return [{column: line.get(column) for column in columns} for line in table.values()]

    def pandas(self) -> Any:
        """:meth:`table` as a pandas frame with index ``(task, system)``."""
        import pandas

        return pandas.DataFrame(self.table()).set_index(["task", "system"])

    def polars(self) -> Any:
        """:meth:`table` as a polars frame."""
        import polars

        return polars.DataFrame(self.table(), infer_schema_length=None)


def evaluate(
    edits: Mapping[str, Mapping[str, _Takes]] | Iterable[_Path],
    items: _Path | _native.Dataset,
    encoder: _Path,
    protocol: Mapping[str, Any] | None = None,
) -> Scores:
    """Scores edits of items as ``stance eval`` does: FID, Diversity, foot score, retrieval and the further metrics.

    ``edits`` maps each system to its motions by item, ``{"my model": {item.id: motion}}``, or to lists of motions if a
    system has several takes of every item; or it names folders that ``stance edit`` wrote. Every item must be
    answered. The table also shows the real data and the identity editor. ``encoder`` is a run of ``stance train tmr``.
    ``protocol`` changes settings, such as ``{"gallery": {"batches": 32}, "repeats": 10}``.
    """
    folders: list[_Path] = []
    systems: list[tuple[str, list[tuple[str, int, Motion]]]] = []
    if isinstance(edits, Mapping):
        for name, answers in edits.items():
            takes = [
                (id, seed, motion)
                for id, answer in answers.items()
                for seed, motion in enumerate([answer] if isinstance(answer, Motion) else answer)
            ]
            systems.append((name, takes))
    else:
        folders = [edits] if isinstance(edits, (str, os.PathLike)) else list(edits)
    rows, text = _native.evaluate(local_path(items), folders, systems, encoder, json.dumps(dict(protocol or {})))
    return Scores(json.loads(rows), text)
