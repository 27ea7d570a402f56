"""Loads a LeRobot export with lerobot, whose tools delete, split and merge its episodes.

    python check_lerobot.py DATASET EXPORT

EXPORT was made of DATASET. Where PyTorch is not installed, `stand_ins` takes its place.
"""

import importlib.util
import pathlib
import sys
import tempfile

import datasets  # noqa: F401  (before the stand-ins, which it would take for PyTorch)
import numpy
import pandas
import pyarrow.parquet

TORCH = importlib.util.find_spec("torch") is not None
if not TORCH:
    sys.path.append(str(pathlib.Path(__file__).parent / "stand_ins"))

from lerobot.datasets.dataset_tools import delete_episodes, merge_datasets, split_dataset
from lerobot.datasets.lerobot_dataset import LeRobotDataset

DATASET, EXPORT = map(pathlib.Path, sys.argv[1:])
MOTION = ("transl", "global_orient", "body_pose")
QUANTILES = ("q01", "q10", "q50", "q90", "q99")


def motions() -> dict[str, dict]:
    shards = sorted((DATASET / "data" / "motions").glob("*.parquet"))
    rows = [row for shard in shards for row in pyarrow.parquet.read_table(shard).to_pylist()]
    return {row["id"]: row for row in rows}


def state(row: dict) -> numpy.ndarray:
    return numpy.hstack([numpy.float32(row[key]) for key in MOTION])


def task(row: dict) -> str:
    return row["captions"][0]["text"] if row["captions"] else ""


def check(rows: dict[str, dict]) -> None:
    episodes = pandas.concat(map(pandas.read_parquet, sorted(EXPORT.glob("meta/episodes/*/*.parquet"))))
    assert sorted(episodes["id"]) == sorted(rows)
    for episode in episodes.itertuples():
        row = rows[episode.id]
        assert list(episode.captions) == [said["text"] for said in row["captions"]]
        assert (episode.license or None) == row["license"], episode.license
        assert list(episode.tasks) == [task(row)]

    loaded = LeRobotDataset("local/stance", root=EXPORT)
    ids = list(loaded.meta.episodes["id"])
    assert len(loaded) == sum(len(row["transl"]) for row in rows.values())
    rates = {row["fps"] for row in rows.values()}
    assert {numpy.float32(loaded.fps)} == {numpy.float32(rate) for rate in rates}, loaded.fps
    for place, episode in enumerate(ids):
        row = rows[episode]
        first = loaded.meta.episodes[place]["dataset_from_index"]
        last = loaded.meta.episodes[place]["dataset_to_index"] - 1
        item = loaded[last]
        assert item["task"] == task(row), item["task"]
        assert numpy.array_equal(item["observation.state"], state(row)[-1])
        assert abs(float(item["timestamp"]) - (last - first) / row["fps"]) < 1e-4
        assert int(item["episode_index"]) == place
    of_state = loaded.meta.stats["observation.state"]
    frames = numpy.vstack([state(rows[episode]) for episode in ids])
    for name, expected in {
        "min": frames.min(axis=0),
        "max": frames.max(axis=0),
        "mean": frames.mean(axis=0, dtype=numpy.float64),
        "std": frames.std(axis=0, dtype=numpy.float64),
    }.items():
        numpy.testing.assert_allclose(of_state[name], expected, rtol=1e-5, atol=1e-6, err_msg=name)
    lengths = [len(rows[episode]["transl"]) for episode in ids]
    for name in QUANTILES:
        share = int(name[1:]) / 100
        each = [numpy.quantile(state(rows[episode]).astype(numpy.float64), share, axis=0) for episode in ids]
        expected = numpy.average(each, axis=0, weights=lengths)
        numpy.testing.assert_allclose(of_state[name], expected, rtol=1e-6, atol=1e-7, err_msg=name)

    with tempfile.TemporaryDirectory() as work:
        work = pathlib.Path(work)
        fewer = delete_episodes(loaded, [0, 2], work / "fewer", "local/fewer")
        kept = [ids[place] for place in range(len(ids)) if place not in (0, 2)]
        check_episodes(fewer, kept, rows)
        parts = split_dataset(loaded, {"a": [0, 1], "b": list(range(2, len(ids)))}, work / "parts")
        check_episodes(parts["a"], ids[:2], rows)
        check_episodes(parts["b"], ids[2:], rows)
        merged = merge_datasets([parts["a"], parts["b"]], "local/merged", work / "merged")
        check_episodes(merged, ids, rows)
        twice = merge_datasets([loaded, merged], "local/twice", work / "twice")
        check_episodes(twice, ids + ids, rows)
    print(f"lerobot: {len(ids)} episodes load, and are deleted, split and merged")
    if not TORCH:
        print("lerobot ran with a stand-in for PyTorch, which is not installed here", file=sys.stderr)


def check_episodes(loaded: LeRobotDataset, ids: list[str], rows: dict[str, dict]) -> None:
    assert loaded.meta.total_episodes == len(ids)
    assert len(loaded) == sum(len(rows[episode]["transl"]) for episode in ids)
    for place, episode in enumerate(ids):
        item = loaded[loaded.meta.episodes[place]["dataset_from_index"]]
        assert item["task"] == task(rows[episode]), (place, item["task"])
        assert numpy.array_equal(item["observation.state"], state(rows[episode])[0])
    for name in ("mean", *QUANTILES):
        assert loaded.meta.stats["observation.state"][name].shape == (69,)


check(motions())
