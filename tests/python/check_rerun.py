"""Reads recordings of `stance.to_rerun` with Rerun's own reader: python check_rerun.py WORK (made by tests/python/package)."""

import pathlib
import sys

import numpy as np
import rerun
import stance
from rerun.chunk import RrdReader

NAMES = ["the original", "edited"]
CAPTION = "A person waves."


def cells(batch, column: str) -> list:
    """A column of lists of numbers, as one array ``[N, D]`` a row."""
    return [np.asarray(row) for row in batch.column(column).to_pylist()]


def check_points(chunk, motion: stance.Motion) -> None:
    batch = chunk.to_record_batch()
    points = np.stack(cells(batch, "Points3D:positions"))
    assert points.shape == (len(motion), 28, 3)
    assert np.array_equal(points.astype(np.float32), motion.keypoints()), "float32 in, float32 out"
    assert batch.column("frame").to_pylist() == list(range(len(motion)))
    seconds = batch.column("time").cast("int64").to_numpy() / 1e9
    # Times are whole nanoseconds.
    assert np.abs(seconds - np.arange(len(motion)) / motion.fps).max() < 1e-8


def matrices(quaternions: np.ndarray) -> np.ndarray:
    """Rotation matrices ``[L, 3, 3]`` of quaternions ``[L, 4]``, the real part last."""
    x, y, z, w = quaternions.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def check_tree(chunks: dict, root: str, motion: stance.Motion) -> None:
    """Checks that the transforms, applied from the pelvis on, lead to the joints."""
    joints = motion.joints()
    found = {root: (np.zeros((len(motion), 3)), np.tile(np.eye(3), (len(motion), 1, 1)))}
    names = stance._native.JOINT_NAMES[:22]
    entities = sorted((entity for entity in chunks if entity.startswith(f"{root}/pelvis")), key=lambda entity: entity.count("/"))
    assert sorted(entity.rsplit("/", 1)[1] for entity in entities) == sorted(names)
    for entity in entities:
        batch = chunks[entity].to_record_batch()
        moved, turned = (np.stack(cells(batch, f"Transform3D:{part}"))[:, 0] for part in ("translation", "quaternion"))
        place, turn = found[entity.rsplit("/", 1)[0]]
        found[entity] = place + np.einsum("lij,lj->li", turn, moved), turn @ matrices(turned)
        joint = names.index(entity.rsplit("/", 1)[1])
        # Rounding of f32 rotations over a chain of eight bones of less than 1 m.
        assert np.abs(found[entity][0] - joints[:, joint]).max() < 1e-5, entity


def check_facts(static: dict) -> None:
    """Checks the static data: names of motions and keypoints, the number of bones, and captions."""
    context = next(chunk for chunk in static["/"] if "AnnotationContext:context" in chunk.to_record_batch().schema.names)
    ((kinds,),) = context.to_record_batch().column("AnnotationContext:context").to_pylist()
    described = [kind["class_description"] for kind in kinds]
    assert [kind["info"]["label"] for kind in described] == NAMES
    for kind in described:
        labels = [point["label"] for point in kind["keypoint_annotations"]]
        assert labels[:2] == ["pelvis", "left_hip"] and labels[26:] == ["right_index1", "right_ring1"], labels
        assert len(kind["keypoint_connections"]) == 27
    (caption,) = static["/edited/caption"]
    assert caption.to_record_batch().column("TextDocument:text").to_pylist() == [[CAPTION]]


def main(work: pathlib.Path) -> None:
    triplet = stance.MotionCutMix(work / "dataset", seed=5).triplet(0, 3)
    motions = [triplet.original, triplet.edited.resample(30)]
    path = work / "edit.rrd"
    stance.to_rerun(path, *motions, names=NAMES, captions=["", CAPTION])
    assert not list(work.glob("*.part"))
    chunks, static = {}, {}
    for chunk in RrdReader(path).stream():
        entity = chunk.entity_path.replace("\\", "")
        if chunk.is_static:
            static.setdefault(entity, []).append(chunk)
        else:
            assert entity not in chunks, "one chunk for each column"
            chunks[entity] = chunk
    for name, motion in zip(NAMES, motions):
        check_points(chunks[f"/{name}/keypoints"], motion)
        check_tree(chunks, f"/{name}", motion)
    check_facts(static)
    try:
        stance.to_rerun(work / "twice.rrd", *motions, names=["a", "a"])
    except ValueError as error:
        assert "differ" in str(error) and not (work / "twice.rrd").exists()
    else:
        raise AssertionError("two entities of one name")
    print(f"a recording of {len(chunks)} entities is read by rerun {rerun.__version__}")


main(pathlib.Path(sys.argv[1]))
