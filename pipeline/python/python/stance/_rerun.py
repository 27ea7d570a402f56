"""Motions as recordings of Rerun."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from . import _native
from ._native import Motion
from ._show import of_each

KEYPOINT_NAMES = [_native.JOINT_NAMES[joint] for joint in _native.KEYPOINT_JOINTS]
NUM_BODY_JOINTS = 22
POINT_RADIUS_M = 0.015


def to_rerun(
    path: str | os.PathLike[str],
    *motions: Motion,
    names: Iterable[str] | None = None,
    captions: Iterable[str] | None = None,
) -> None:
    """Writes motions as one recording for `Rerun <https://rerun.io>`_: ``rerun FILE.rrd`` shows it. Needs rerun-sdk.

    Each motion is an entity with its name (by default ``motion0``, ``motion1``, …): the 28 keypoints in metres under
    ``keypoints``, with their names and bones; the 22 joints as a tree of transforms from ``pelvis`` on; and the caption
    as text. The timelines are ``time`` in seconds and ``frame``.
    """
    try:
        import rerun
    except ImportError as error:
        raise ImportError("recordings need Rerun: pip install rerun-sdk") from error
    if not motions:
        raise ValueError("there is no motion to write")
    titles = [f"motion{number}" for number in range(len(motions))] if names is None else of_each("names", names, motions)
    if len(set(titles)) < len(titles) or not all(titles):
        raise ValueError(f"names must differ and not be empty, got {titles}")
    recording = rerun.RecordingStream("stance")
    # Write to a temporary file, so that no incomplete recording is left behind.
    part = Path(f"{os.fspath(path)}.{os.getpid()}.part")
    recording.save(part)
    try:
        recording.log("/", rerun.ViewCoordinates.RIGHT_HAND_Y_UP, static=True, strict=True)
        recording.log("/", _annotations(rerun, titles), static=True, strict=True)
        for number, (title, caption, motion) in enumerate(zip(titles, of_each("captions", captions, motions), motions)):
            root = "/" + rerun.escape_entity_path_part(title)
            if caption:
                recording.log(f"{root}/caption", rerun.TextDocument(caption), static=True, strict=True)
            _log_keypoints(rerun, recording, f"{root}/keypoints", motion, number)
            _log_transforms(rerun, recording, root, motion)
        recording.disconnect()
        part.replace(path)
    finally:
        recording.disconnect()
        part.unlink(missing_ok=True)


def _annotations(rerun: Any, titles: list[str]) -> Any:
    """A class for each motion, with the names of the keypoints and the bones between them."""
    bones = [(parent, point) for point, parent in enumerate(_native.KEYPOINT_PARENTS) if parent >= 0]
    points = [rerun.AnnotationInfo(id=point, label=name) for point, name in enumerate(KEYPOINT_NAMES)]
    return rerun.AnnotationContext([
        rerun.ClassDescription(
            info=rerun.AnnotationInfo(id=number, label=title), keypoint_annotations=points, keypoint_connections=bones
        )
        for number, title in enumerate(titles)
    ])


def _times(rerun: Any, motion: Motion) -> list[Any]:
    frames = np.arange(len(motion))
    return [rerun.TimeColumn("frame", sequence=frames), rerun.TimeColumn("time", duration=frames / motion.fps)]


def _log_keypoints(rerun: Any, recording: Any, entity: str, motion: Motion, number: int) -> None:
    points = motion.keypoints()
    kinds = rerun.Points3D.from_fields(
        class_ids=number, keypoint_ids=np.arange(points.shape[1]), radii=POINT_RADIUS_M, show_labels=False
    )
    recording.log(entity, kinds, static=True, strict=True)
    columns = rerun.Points3D.columns(positions=points.reshape(-1, 3)).partition([points.shape[1]] * len(points))
    recording.send_columns(entity, _times(rerun, motion), columns, strict=True)


def _log_transforms(rerun: Any, recording: Any, root: str, motion: Motion) -> None:
    """Logs each joint as an entity below its parent: its local rotation, and its offset from the parent."""
    rest = _rest(motion)
    vectors = np.concatenate([motion.global_orient, motion.body_pose], 1).reshape(len(motion), NUM_BODY_JOINTS, 3)
    turns = _quaternions(vectors)
    entities: list[str] = []
    for joint, parent in enumerate(_native.KEYPOINT_PARENTS[:NUM_BODY_JOINTS]):
        entities.append(f"{entities[parent] if parent >= 0 else root}/{KEYPOINT_NAMES[joint]}")
        places = np.tile(rest[joint] - rest[parent], (len(motion), 1)) if parent >= 0 else motion.joints()[:, 0]
        columns = rerun.Transform3D.columns(translation=places, quaternion=turns[:, joint])
        recording.send_columns(entities[joint], _times(rerun, motion), columns, strict=True)


def _rest(motion: Motion) -> np.ndarray:
    """The 22 joints of a motion's body at rest, ``[22, 3]`` in metres."""
    # The skeleton of a motion is only available from its pickled parts.
    restored, (_, _, _, fps, skeleton) = motion.__reduce__()
    zeros = [np.zeros((1, width), np.float32) for width in (3, 3, 63)]
    return restored(*zeros, fps, skeleton).joints()[0]


def _quaternions(vectors: np.ndarray) -> np.ndarray:
    """Converts axis-angle vectors ``[..., 3]`` in radians to quaternions ``[..., 4]``, real part last."""
    vectors = vectors.astype(np.float64)
    half = np.linalg.norm(vectors, axis=-1, keepdims=True) / 2
    # sin(half) / (2 half), which is 1/2 if nothing turns.
    return np.concatenate([np.sinc(half / np.pi) / 2 * vectors, np.cos(half)], -1)
