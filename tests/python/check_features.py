"""Loads exported features by the rules of the programs that train on them, and compares their rotations with the
dataset.

    python check_features.py DATASET EXPORTS

EXPORTS holds `humanml3d-272`, `motionmillion` and `hy-motion`. The dataset has 20 fps and the features 30, so every
second frame of the dataset is every third of the features.
"""

import csv
import pathlib
import sys

import numpy
import pyarrow.parquet

DATASET, EXPORTS = map(pathlib.Path, sys.argv[1:])


def motions() -> dict[str, dict]:
    shards = sorted((DATASET / "data" / "motions").glob("*.parquet"))
    rows = [row for shard in shards for row in pyarrow.parquet.read_table(shard).to_pylist()]
    return {row["id"]: row for row in rows}


def matrices(vectors: numpy.ndarray) -> numpy.ndarray:
    """Rotation matrices of axis-angle vectors `[..., 3]`, by Rodrigues' formula."""
    angles = numpy.linalg.norm(vectors, axis=-1)[..., None, None]
    x, y, z = numpy.moveaxis(vectors / numpy.maximum(angles[..., 0], 1e-12), -1, 0)
    zero = numpy.zeros_like(x)
    cross = numpy.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(*x.shape, 3, 3)
    return numpy.eye(3) + numpy.sin(angles) * cross + (1 - numpy.cos(angles)) * cross @ cross


def about_y(angles: numpy.ndarray) -> numpy.ndarray:
    cosines, sines = numpy.cos(angles), numpy.sin(angles)
    zero, one = numpy.zeros_like(angles), numpy.ones_like(angles)
    return numpy.stack([cosines, zero, sines, zero, one, zero, -sines, zero, cosines], -1).reshape(-1, 3, 3)


def rotations(row: dict) -> numpy.ndarray:
    """Local rotations of every second frame, turned so that the first faces +z: `[L, 22, 3, 3]`."""
    root, body = numpy.float64(row["global_orient"]), numpy.float64(row["body_pose"])
    found = matrices(numpy.concatenate([root[:, None], body.reshape(-1, 21, 3)], 1)[::2])
    heading = numpy.arctan2(found[:1, 0, 0, 2], found[:1, 0, 2, 2])
    found[:, 0] = about_y(-heading) @ found[:, 0]
    return found


def names(folder: pathlib.Path) -> dict[str, str]:
    with open(folder / "ids.csv", newline="") as file:
        return {line["name"]: line["id"] for line in csv.DictReader(file)}


def listed(path: pathlib.Path) -> list[str]:
    return [line.strip() for line in path.read_text().splitlines()]


def check_rotations_272(features: numpy.ndarray, row: dict) -> None:
    expected = rotations(row)
    frames = features[::3].astype(numpy.float64)[: len(expected)]
    found = frames[:, 140:].reshape(-1, 22, 2, 3)
    # The steps of the heading accumulate by multiplication from the left; the features have roots without heading.
    steps = features[:, 2:8].reshape(-1, 2, 3).astype(numpy.float64)
    steps = numpy.concatenate([steps, numpy.cross(steps[:, 0], steps[:, 1])[:, None]], 1)
    headings = [steps[0]]
    for step in steps[1:]:
        headings.append(step @ headings[-1])
    seen = numpy.stack(headings)[::3][: len(expected)] @ expected[:, 0]
    assert numpy.allclose(found[:, 0], seen[:, :2], atol=1e-4)
    assert numpy.allclose(found[:, 1:], expected[:, 1:, :2], atol=1e-5)


def check_humanml3d_272(rows: dict[str, dict]) -> None:
    """Reads what MotionStreamer's datasets read."""
    root = EXPORTS / "humanml3d-272"
    mean, std = numpy.load(root / "mean_std" / "Mean.npy"), numpy.load(root / "mean_std" / "Std.npy")
    assert mean.shape == std.shape == (272,)
    for start, end in [(0, 2), (2, 8), (8, 74), (74, 140), (140, 272)]:
        assert (std[start:end] == std[start]).all() and std[start] > 0
    ids, count = names(root), 0
    for split in ("train", "val", "test"):
        for name in listed(root / "split" / f"{split}.txt"):
            motion = numpy.load(root / "motion_data" / f"{name}.npy")
            row = rows[ids[name]]
            assert row["split"] == split and motion.shape[1] == 272
            assert numpy.isfinite((motion - mean) / std).all()
            for line in (root / "texts" / f"{name}.txt").read_text().splitlines():
                caption, tokens, start, end = line.strip().split("#")
                assert caption and all("/" in token for token in tokens.split(" ")), line
                assert float(start) <= float(end) or float(end) == 0.0
            check_rotations_272(motion, row)
            count += 1
    assert count == len(rows)
    print(f"humanml3d-272: {count} clips")


def check_motionmillion(rows: dict[str, dict]) -> None:
    """Reads what MotionMillion's datasets read."""
    root = EXPORTS / "motionmillion"
    statistics = root / "mean_std" / "vector_272"
    mean, std = numpy.load(statistics / "mean.npy"), numpy.load(statistics / "std.npy")
    lists = root / "split" / "version1"
    ids, seen = names(root), set()
    for split in ("train", "val", "test"):
        short = set(listed(lists / "t2m_60_300" / f"{split}.txt"))
        for name in listed(lists / "any_length" / f"{split}.txt"):
            motion = numpy.load(root / "motion_data" / "vector_272" / f"{name}.npy")
            assert (name in short) == (60 <= len(motion) <= 300), name
            assert numpy.isfinite((motion - mean) / std).all()
            captions = (root / "texts" / f"{name}.txt").read_text().splitlines()
            assert all(caption.strip() for caption in captions)
            check_rotations_272(motion, rows[ids[name]])
            seen.add(name)
    assert len(seen) == len(rows)
    assert set(listed(lists / "any_length" / "all.txt")) == seen
    print(f"motionmillion: {len(seen)} clips")


def check_hy_motion(rows: dict[str, dict]) -> None:
    """Reads the columns as HY-Motion's decoder does, and the statistics."""
    root = EXPORTS / "hy-motion"
    for name in ("Mean", "Std"):
        assert numpy.load(root / "stats" / f"{name}.npy")[None].shape == (1, 201)
    ids = names(root)
    for name, motion_id in ids.items():
        motion = numpy.load(root / "motion_data" / f"{name}.npy")
        expected = rotations(rows[motion_id])
        found = motion[::3, 3:135].astype(numpy.float64).reshape(-1, 22, 3, 2)[: len(expected)]
        assert numpy.allclose(found, expected[..., :2], atol=1e-5), name
        assert numpy.allclose(motion[0, [0, 2]], 0), name
        # The pelvis has its rest position in every frame.
        assert (motion[:, 135:138] == motion[0, 135:138]).all(), name
    print(f"hy-motion: {len(ids)} clips")


def main() -> None:
    rows = motions()
    check_humanml3d_272(rows)
    check_motionmillion(rows)
    check_hy_motion(rows)


main()
