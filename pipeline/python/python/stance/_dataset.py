"""Datasets: motions one by one, and tables as Arrow, polars or pandas."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from . import _native
from ._remote import Remote, is_url

if TYPE_CHECKING:
    import pyarrow as pa

    from ._native import Item, Motion


class Dataset(_native.Dataset):
    """A dataset folder, as ``stance ingest`` writes it. Every file is checked against its hash unless ``verify`` is false.

    ``len(dataset)`` is the number of clips, ``dataset[id]`` reads the motion of a clip (only its pages), and iterating
    gives ``(id, Motion)``.

    ``path`` may be a URL that fsspec opens (``s3://``, ``https://``, ``hf://``): the files of a table are copied into
    ``STANCE_CACHE`` (``~/.cache/stance``) when the table is first read.
    """

    _remote: Remote | None

    def __new__(cls, path: str | os.PathLike[str], *, verify: bool = True) -> Dataset:
        remote = Remote(path) if is_url(path) else None
        if remote is None:
            made = super().__new__(cls, path, verify=verify)
        else:
            # Each file is verified when it is copied.
            made = super().__new__(cls, remote.local, verify=False)
        made._remote = remote
        return made

    def fetch(self, *tables: str) -> Dataset:
        """Copies the files of these tables (default: all) of a remote dataset; does nothing for a local one."""
        if self._remote is not None:
            for table in tables or self.manifest["tables"]:
                self._remote.fetch(table)
        return self

    @cached_property
    def manifest(self) -> dict[str, Any]:
        """The manifest: tables, files, hashes, accounting and facts."""
        return json.loads(self._manifest())

    @property
    def tables(self) -> dict[str, int]:
        """Number of rows of each table."""
        return {name: self.num_rows(name) for name in self.manifest["tables"]}

    def __len__(self) -> int:
        return self.num_rows("motions")

    def __getitem__(self, id: str) -> Motion:
        return self.motion(id)

    def __iter__(self) -> Iterator[tuple[str, Motion]]:
        return self.motions()

    def __repr__(self) -> str:
        rows = ", ".join(f"{count} {name}" for name, count in self.tables.items())
        return f"Dataset({str(self.path)!r}: {rows})"

    def files(self, table: str, split: str | None = None) -> list[Path]:
        """Parquet files of a table."""
        self.fetch(table)
        return super().files(table, split)

    def ids(self, split: str | None = None) -> list[str]:
        """Ids of the clips, in the order of the files."""
        self.fetch("motions")
        return super().ids(split)

    def motion(self, id: str) -> Motion:
        """The motion of a clip."""
        self.fetch("motions")
        return super().motion(id)

    def items(self) -> list[Item]:
        """The test questions of a folder that ``stance items`` wrote."""
        self.fetch("items")
        return super().items()

    def motions(self, split: str | None = None) -> Iterator[tuple[str, Motion]]:
        """Id and motion of every clip, file by file."""
        for file in self.files("motions", split):
            yield from self._motions_of(file)

    def table(self, name: str, split: str | None = None, columns: list[str] | None = None) -> pa.Table:
        """A table as Arrow, memory-mapped. Needs pyarrow."""
        try:
            import pyarrow as pa
            import pyarrow.parquet as pq
        except ImportError as error:
            raise ImportError("tables need pyarrow: pip install pyarrow") from error
        files = self.files(name, split)
        if not files:
            known = ", ".join(self.manifest["tables"])
            raise KeyError(f"{self.path} has no table {name!r} of split {split}; its tables are {known}")
        parts = [pq.read_table(file, columns=columns, memory_map=True, partitioning=None) for file in files]
        return pa.concat_tables(parts)

    def polars(self, name: str, split: str | None = None, columns: list[str] | None = None) -> Any:
        """A table as a polars frame, which shares Arrow's memory."""
        import polars

        return polars.from_arrow(self.table(name, split, columns))

    def pandas(self, name: str, split: str | None = None, columns: list[str] | None = None) -> Any:
        """A table as a pandas frame."""
        return self.table(name, split, columns).to_pandas()

    def arrays(self, name: str, column: str, split: str | None = None) -> list[np.ndarray]:
        """A column of frames, such as ``transl`` of ``motions``: one array ``[L, D]`` for each row.

        The arrays are read-only views of Arrow's memory; nothing is copied.
        """
        found: list[np.ndarray] = []
        for chunk in self.table(name, split, [column]).column(column).chunks:
            width = chunk.type.value_type.list_size
            offsets = chunk.offsets.to_numpy()
            frames = chunk.values.flatten().to_numpy(zero_copy_only=True).reshape(-1, width)
            found += [frames[a:b] for a, b in zip(offsets[:-1], offsets[1:])]
        return found


def local_path(dataset: str | os.PathLike[str] | _native.Dataset) -> str:
    """The folder of a dataset; all files of a remote dataset are copied first."""
    if is_url(dataset):
        dataset = Dataset(dataset)
    if isinstance(dataset, Dataset):
        return os.fspath(dataset.fetch().path)
    return os.fspath(dataset)
