"""Counts the rows that a search for Parquet files finds, with the readers that people use.

    python check_globs.py DATASET

Polars, DuckDB, pyarrow and `datasets` read every table by plain patterns, and all find the rows of the newest version once.
"""

import json
import sys
from importlib.metadata import version
from pathlib import Path

import datasets
import duckdb
import polars
import pyarrow.dataset


def newest_manifest(root: Path) -> dict:
    manifests = root.glob("meta/manifest-*.json")
    newest = max(manifests, key=lambda path: int(path.stem.rsplit("-", 1)[1]))
    return json.loads(newest.read_text())


def by_datasets(root: Path, table: str) -> int:
    files = {"rows": str(root / "data" / table / "*.parquet")}
    return datasets.load_dataset("parquet", data_files=files, split="rows").num_rows


READERS = {
    "polars": lambda root, table: polars.scan_parquet(root / "data" / table / "*.parquet").select(polars.len()).collect().item(),
    "duckdb": lambda root, table: duckdb.sql(f"select count(*) from '{root}/data/{table}/*.parquet'").fetchall()[0][0],
    "pyarrow": lambda root, table: pyarrow.dataset.dataset(root / "data" / table, format="parquet").count_rows(),
    "datasets": by_datasets,
}


def main() -> None:
    root = Path(sys.argv[1])
    manifest = newest_manifest(root)
    total = 0
    for table, files in manifest["tables"].items():
        expected = sum(file["rows"] for file in files)
        total += expected
        for name, count in READERS.items():
            if name == "datasets" and expected == 0:
                continue  # It refuses files without rows.
            found = count(root, table)
            assert found == expected, f"{name}: {found} rows of {table}, the manifest says {expected}"
    everything = [path for path in root.rglob("*.parquet")]
    named = {str(root / file["path"]) for files in manifest["tables"].values() for file in files}
    assert {str(path) for path in everything} == named, "a search from the root finds other files"
    versions = ", ".join(f"{name} {version(name)}" for name in READERS)
    print(f"version {manifest['version']}: {total} rows, the same by {versions}")


main()
