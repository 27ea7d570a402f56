"""Loads a dataset folder with the real Python packages and compares it with its manifest.

    python check_dataset.py DATASET

Every table must load with `datasets.load_dataset` without a script, with as many rows as the
manifest says and with frames as arrays of the documented width; the Croissant metadata must validate
and yield a record of every table.
"""

import json
import sys
from importlib.metadata import version
from pathlib import Path

import datasets
import mlcroissant
import numpy
import pyarrow.parquet

FRAME_WIDTHS = {
    "motions": {"transl": 3, "global_orient": 3, "body_pose": 63},
    "markers": {"positions": 3, "residuals": 1},
    "humanml3d": {"features": 263},
}


def newest_manifest(root: Path) -> dict:
    manifests = root.glob("meta/manifest-*.json")
    newest = max(manifests, key=lambda path: int(path.stem.rsplit("-", 1)[1]))
    return json.loads(newest.read_text())


def check_tables(root: Path, manifest: dict) -> int:
    rows_seen = 0
    for table, files in manifest["tables"].items():
        expected = sum(file["rows"] for file in files)
        if expected == 0:
            continue
        loaded = datasets.load_dataset(str(root), table)
        found = sum(split.num_rows for split in loaded.values())
        assert found == expected, f"{table}: {found} rows, the manifest says {expected}"
        rows_seen += found
        for split in loaded.values():
            row = split.with_format("numpy")[0]
            for column, width in FRAME_WIDTHS.get(table, {}).items():
                frames = row[column]
                assert frames.dtype == numpy.float32, f"{table}.{column} is {frames.dtype}"
                assert frames.ndim == 2 and frames.shape[1] == width, f"{table}.{column}: {frames.shape}"
    return rows_seen


def list_columns(root: Path, manifest: dict, table: str) -> set[str]:
    """Columns with a list of plain values in each row."""
    schema = pyarrow.parquet.read_schema(root / manifest["tables"][table][0]["path"])
    is_list = lambda kind: pyarrow.types.is_list(kind) and not pyarrow.types.is_nested(kind.value_type)
    return {field.name for field in schema if is_list(field.type)}


def check_croissant(root: Path, manifest: dict) -> int:
    metadata = mlcroissant.Dataset(jsonld=str(root / "croissant.json"))
    sets = metadata.metadata.record_sets
    for record_set in sets:
        record = next(iter(metadata.records(record_set.uuid)))
        assert record, f"{record_set.uuid} yields nothing"
        table = record_set.uuid.split("/")[0]
        lists = list_columns(root, manifest, table)
        declared = {field.name for field in record_set.fields if field.repeated}
        assert declared == lists, f"{record_set.uuid}: {declared} are declared as lists, {lists} are"
        for column in lists:
            value = record[f"{record_set.uuid}/{column}"]
            assert isinstance(value, (list, numpy.ndarray)), f"{table}.{column} is a {type(value)}"
    with_rows = sum(1 for files in manifest["tables"].values() for file in files if file["rows"])
    assert len(sets) == with_rows, f"{len(sets)} record sets, {with_rows} files with rows"
    return len(sets)


def main() -> None:
    root = Path(sys.argv[1])
    manifest = newest_manifest(root)
    rows = check_tables(root, manifest)
    sets = check_croissant(root, manifest)
    print(f"{rows} rows of {sets} files load with datasets {datasets.__version__} "
          f"and mlcroissant {version('mlcroissant')}")


if __name__ == "__main__":
    main()
