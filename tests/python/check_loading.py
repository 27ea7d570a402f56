"""Runs the lines of datasets-spec/docs/python.md that load a dataset: python check_loading.py DATASET.

Each must give columns of the types that the page states, as many rows as the manifest has, and the numbers that
`stance.Dataset` gives.
"""

import os
import pathlib
import re
import sys
import tempfile

CACHE = tempfile.TemporaryDirectory()
os.environ |= {"HF_HOME": CACHE.name, "HF_HUB_OFFLINE": "1", "HF_DATASETS_DISABLE_PROGRESS_BARS": "1"}

import datasets
import numpy as np
import polars
import stance

DOCUMENT = pathlib.Path(__file__).parents[2] / "datasets-spec" / "docs" / "python.md"
FRAMES = {"transl": 3, "global_orient": 3, "body_pose": 63}


def tables_of_section() -> list[list[list[str]]]:
    """Cells of the two tables of the section `In one line`."""
    section = DOCUMENT.read_text().split("## In one line")[1].split("\n## ")[0]
    tables = re.findall(r"(?:^\|.*\n)+", section, re.MULTILINE)
    return [[[cell.strip() for cell in line.strip("|\n").split("|")] for line in table.splitlines()[2:]] for table in tables]


def check_types(loaded: datasets.Dataset | polars.DataFrame, stated: list[list[str]]) -> None:
    of_datasets = isinstance(loaded, datasets.Dataset)
    types = loaded.features if of_datasets else loaded.schema
    for names, *kinds in stated:
        kind = kinds[0 if of_datasets else 1].strip("`")
        for name in re.findall(r"`(\w+)`", names):
            assert str(types[name]) == kind, f"{name} is {types[name]}, the page says {kind}"


def check_numbers(loaded: datasets.Dataset | polars.DataFrame, dataset: stance.Dataset) -> None:
    ids = list(loaded["id"])
    assert ids == dataset.ids("train"), "the same clips in the same order"
    for place in (0, len(ids) // 2, len(ids) - 1):
        row = loaded[place] if isinstance(loaded, datasets.Dataset) else loaded.row(place, named=True)
        motion = dataset[ids[place]]
        assert (row["fps"], row["n_frames"], row["content_hash"]) == (motion.fps, len(motion), motion.content_hash)
        for column, width in FRAMES.items():
            frames = np.array(row[column], np.float32)
            assert frames.shape == (len(motion), width)
            assert np.array_equal(frames, getattr(motion, column)), (ids[place], column)


def main(folder: str) -> None:
    dataset = stance.Dataset(folder)
    lines, stated = tables_of_section()
    for _, line, _ in lines:
        loaded = eval(line.strip("`").replace("DATASET", folder), {"datasets": datasets, "polars": polars, "stance": stance})
        assert len(loaded) == dataset.num_rows("motions", "train"), line
        check_types(loaded, stated)
        check_numbers(loaded, dataset)
    # Every table and split of the dataset's card loads.
    for table, rows in dataset.tables.items():
        if rows > 0:
            splits = datasets.load_dataset(folder, table)
            assert sum(split.num_rows for split in splits.values()) == rows, table
            for name, split in splits.items():
                assert name == "rows" or split.num_rows == dataset.num_rows(table, name), (table, name)
    print(f"{len(lines)} ways to load a dataset agree, with datasets {datasets.__version__} and polars {polars.__version__}")


main(sys.argv[1])
