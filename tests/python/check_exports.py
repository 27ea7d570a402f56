"""Loads exports with the packages that people use, and compares them with the dataset they were made of.

    python check_exports.py DATASET EXPORTS

EXPORTS holds the folders `webdataset` and `amass`: the first is streamed by webdataset, the archives are read
as GMR reads them.
"""

import json
import pathlib
import sys

import numpy
import pyarrow.parquet
import webdataset

DATASET, EXPORTS = map(pathlib.Path, sys.argv[1:])
MOTION = ("transl", "global_orient", "body_pose")


def motions() -> dict[str, dict]:
    shards = sorted((DATASET / "data" / "motions").glob("*.parquet"))
    rows = [row for shard in shards for row in pyarrow.parquet.read_table(shard).to_pylist()]
    return {row["id"]: row for row in rows}


def check_webdataset(rows: dict[str, dict]) -> None:
    shards = sorted(map(str, (EXPORTS / "webdataset").glob("*.tar")))
    samples = webdataset.WebDataset(shards, shardshuffle=False).decode()
    seen = set()
    for sample in samples:
        facts = sample["json"]
        row = rows[facts["id"]]
        for name in MOTION:
            assert numpy.array_equal(sample[f"{name}.npy"], numpy.float32(row[name])), facts["id"]
        assert [said["text"] for said in facts["captions"]] == [said["text"] for said in row["captions"]]
        assert (facts["license"], facts["split"], facts["fps"]) == (row["license"], row["split"], row["fps"])
        assert pathlib.Path(sample["__url__"]).name.startswith(row["split"])
        seen.add(facts["id"])
    assert seen == set(rows)
    print(f"webdataset: {len(seen)} clips of {len(shards)} shards")


GMR_FPS = 30


def check_amass(rows: dict[str, dict]) -> None:
    """Reads what GMR's `load_smplx_file` and `get_smplx_data_offline_fast` read: keys, shapes, and the rate. GMR drops
    frames of motions above 30 fps, and plays motions below 30 fps too fast."""
    archives = sorted((EXPORTS / "amass").rglob("*.npz"))
    assert len(archives) == len(rows)
    for path in archives:
        data = numpy.load(path, allow_pickle=True)
        frames = data["pose_body"].shape[0]
        assert str(data["gender"]) == "neutral"
        assert data["betas"].reshape(1, -1).shape == (1, 16)
        assert data["root_orient"].shape == data["trans"].shape == (frames, 3)
        assert data["pose_body"].shape == (frames, 63)
        height = 1.66 + 0.1 * data["betas"][0]
        assert numpy.isclose(height, 1.66)
        assert data["mocap_frame_rate"].item() == data["mocap_framerate"].item()
        fps = data["mocap_frame_rate"].item()
        assert int(fps / GMR_FPS) >= 1, fps
        name = path.relative_to(EXPORTS / "amass").with_suffix("").as_posix().removesuffix("_stageii")
        row = rows[name]
        times = round(fps / row["fps"])
        assert frames == times * (row["n_frames"] - 1) + 1, (frames, row["n_frames"])
        body = data["pose_body"][::times]
        assert numpy.allclose(body, row["body_pose"], atol=1e-5), name
        # z is up: the heights of the pelvis are those of the dataset.
        heights = data["trans"][::times, 2] - data["trans"][0, 2]
        expected = numpy.float64(row["transl"])[:, 1] - row["transl"][0][1]
        assert numpy.allclose(heights, expected, atol=1e-5), name
        assert data["poses"].shape == (frames, 165)
        sidecar = json.loads(path.with_suffix(".stance.json").read_text())
        texts = [said["text"] for said in sidecar.get("captions", [])]
        assert any(texts == [said["text"] for said in row["captions"]] for row in rows.values()), texts
    print(f"amass: {len(archives)} archives have the keys that GMR reads")


def main() -> None:
    rows = motions()
    check_webdataset(rows)
    check_amass(rows)


main()
