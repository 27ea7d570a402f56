"""Datasets at addresses such as s3://bucket/dataset, https://host/dataset or hf://datasets/owner/name, by fsspec."""

from __future__ import annotations

import hashlib
import json
import os
import re
from pathlib import Path
from typing import Any

from ._errors import Error

MANIFEST = re.compile(r"manifest-(\d+)\.json$")


def is_url(path: Any) -> bool:
    return isinstance(path, str) and "://" in path


def cache_folder() -> Path:
    """Where files of remote datasets are kept: ``STANCE_CACHE``, or ``stance`` in the user's cache folder."""
    own = os.environ.get("STANCE_CACHE")
    base = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA") or Path.home() / ".cache"
    return Path(own) if own else Path(base) / "stance"


class Remote:
    """The newest version of a remote dataset, copied file by file when a file is needed.

    Copies lie in a folder named by the root hash of the dataset. Each is checked against its SHA-256, and appears whole
    or not at all.
    """

    def __init__(self, url: str) -> None:
        try:
            import fsspec
        except ImportError as error:
            raise ImportError(f"{url} needs fsspec and the package of its protocol: pip install fsspec") from error
        self.url = url.rstrip("/")
        self.store, self.root = fsspec.core.url_to_fs(self.url)
        try:
            names = self.store.ls(f"{self.root}/meta", detail=False)
        except FileNotFoundError:
            names = []
        found = {int(match[1]): name for name in names if (match := MANIFEST.search(name))}
        if not found:
            raise Error(f"{url} is no dataset: it has no meta/manifest-<n>.json", "E-DATASET", url)
        newest = found[max(found)]
        text = self.store.cat_file(newest)
        self.manifest = json.loads(text)
        self.local = cache_folder() / self.manifest["root_hash"]
        self._write(self.local / "meta" / newest.rsplit("/", 1)[1], text)

    def _write(self, path: Path, content: bytes) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_name(f"{path.name}.{os.getpid()}.part")
        part.write_bytes(content)
        part.replace(path)

    def fetch(self, table: str) -> None:
        """Copies the files of a table that are not here yet."""
        for file in self.manifest["tables"].get(table, []):
            path = self.local / file["path"]
            if path.exists() and path.stat().st_size == file["bytes"]:
                continue
            content = self.store.cat_file(f"{self.root}/{file['path']}")
            if hashlib.sha256(content).hexdigest() != file["sha256"]:
                raise Error(f"{self.url}/{file['path']} does not match its hash; fetch it again", "E-CORRUPT", file["path"])
            self._write(path, content)
