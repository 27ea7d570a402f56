"""Loads a dump as MotionFix's data module does, and compares it with the triplets it was made of.

    python check_motionfix.py TRIPLETS EXPORT

The rules are those of `MotionFixDataModule` and of its five features. The released program is not run: it needs the
licensed SMPL-H model, although nothing that is checked here depends on it.
"""

import csv
import json
import pathlib
import sys

import joblib
import numpy
import pyarrow.parquet

TRIPLETS, EXPORT = map(pathlib.Path, sys.argv[1:])
FPS = 30


def triplets() -> dict[str, dict]:
    shards = sorted((TRIPLETS / "data" / "triplets").glob("*.parquet"))
    rows = [row for shard in shards for row in pyarrow.parquet.read_table(shard).to_pylist()]
    return {row["id"]: row for row in rows}


def as_floats(value):
    """Arrays of numbers become single precision; everything else stays as it is."""
    if isinstance(value, dict):
        return {key: as_floats(item) for key, item in value.items()}
    return value.astype(numpy.float32) if isinstance(value, numpy.ndarray) else value


def matrices(vectors: numpy.ndarray) -> numpy.ndarray:
    angles = numpy.linalg.norm(vectors, axis=-1)[..., None, None]
    x, y, z = numpy.moveaxis(vectors / numpy.maximum(angles[..., 0], 1e-12), -1, 0)
    zero = numpy.zeros_like(x)
    cross = numpy.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(*x.shape, 3, 3)
    return numpy.eye(3) + numpy.sin(angles) * cross + (1 - numpy.cos(angles)) * cross @ cross


def about_z(root: numpy.ndarray) -> numpy.ndarray:
    """The headings of root rotations: their rotations about z, which are applied last."""
    angles = numpy.arctan2(root[:, 1, 0], root[:, 0, 0])
    return matrices(angles[:, None] * numpy.float64([0, 0, 1]))


def features(motion: dict) -> numpy.ndarray:
    """The 207 features of TMED: `[L, 207]`."""
    rots = motion["rots"].astype(numpy.float64)
    trans, joints = motion["trans"].astype(numpy.float64), motion["joint_positions"].astype(numpy.float64)
    frames = len(rots)
    assert rots.shape == (frames, 66) and trans.shape == (frames, 3) and joints.shape == (frames, 22, 3)
    root, heading = matrices(rots[:, :3]), about_z(matrices(rots[:, :3]))
    moved = numpy.zeros((frames, 3))
    moved[1:] = numpy.einsum("fji,fj->fi", root[:-1], trans[1:] - trans[:-1])
    turned = numpy.tile(numpy.eye(3), (frames, 1, 1))
    turned[1:] = heading[:-1].transpose(0, 2, 1) @ heading[1:]
    tilted = heading.transpose(0, 2, 1) @ root
    local = numpy.einsum("fdi,fjd->fji", heading, joints - joints[:, :1])
    body = matrices(rots[:, 3:].reshape(frames, 21, 3))
    parts = [moved, tilted[:, :2], turned[:, :2], body[:, :, :2], local]
    return numpy.concatenate([part.reshape(frames, -1) for part in parts], 1)


def check_side(motion: dict, row: dict, side: str) -> None:
    """Compares a motion with its row: every second frame at 20 fps is every third at 30 fps."""
    assert row["fps"] == 20
    body = numpy.float64(row[f"{side}_body_pose"])[::2]
    found = motion["rots"][::3, 3:][: len(body)]
    expected = matrices(body.reshape(-1, 21, 3))
    assert numpy.allclose(matrices(found.reshape(-1, 21, 3).astype(numpy.float64)), expected, atol=1e-5)
    assert (motion["trans"][0] == 0).all()
    # z is up: heights are those of y in the dataset, less the height of the first frame.
    heights = numpy.float64(row[f"{side}_transl"])[::2, 1]
    rise = motion["trans"][::3, 2][: len(heights)]
    assert numpy.allclose(rise, heights - heights[0], atol=1e-5)
    start, end = motion["timestamp"]
    assert 0 <= start < end
    root = matrices(motion["rots"][:, :3].astype(numpy.float64))
    angles = numpy.unwrap(numpy.arctan2(root[:, 1, 0], root[:, 0, 0]))
    begin = numpy.pi / 4 + angles[1] - angles[0]
    assert numpy.isclose(numpy.cos(angles[0] - begin), 1, atol=1e-8), (angles[0], begin)


def main() -> None:
    rows = triplets()
    with open(EXPORT / "ids.csv", newline="") as file:
        ids = {line["key"]: line["id"] for line in csv.DictReader(file)}
    splits = json.loads((EXPORT / "splits.json").read_text())
    dump = as_floats(joblib.load(EXPORT / "motionfix.pth.tar"))
    assert len(dump) == len(rows) == len(ids)
    assert sorted(key for keys in splits.values() for key in keys) == sorted(dump)
    stacked = []
    for key, datum in dump.items():
        row = rows[ids[key]]
        assert len(key) == 15 and int(key) < 2**53, "a number that double precision holds"
        assert key in splits[row["split"]] and datum["text"] == row["instruction"].strip()
        check_side(datum["motion_source"], row, "original")
        check_side(datum["motion_target"], row, "edited")
        stacked += [features(datum["motion_source"]), features(datum["motion_target"])]
    stacked = numpy.concatenate(stacked)
    assert stacked.shape[1] == 207 and numpy.isfinite(stacked).all()
    for split in ("val", "test"):
        part = joblib.load(EXPORT / f"motionfix_{split}.pth.tar")
        assert sorted(part) == sorted(splits[split])
    print(f"motionfix: {len(dump)} triplets, {len(stacked)} frames of 207 features")


main()
