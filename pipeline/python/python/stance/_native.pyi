"""Types of the compiled half of the package. Shapes: ``L`` frames, ``N`` and ``M`` latents of ``D`` numbers."""

import os
from typing import Any, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

_Path = str | os.PathLike[str]
_F32 = NDArray[np.float32]

VERSION: str
SCHEMA_VERSION: str
JOINT_NAMES: list[str]
"""Names of the 55 SMPL-X joints."""
KEYPOINT_JOINTS: list[int]
"""Index of the joint of each of the 28 keypoints; the first 22 are the body joints."""
KEYPOINT_PARENTS: list[int]
"""Parent of each keypoint; -1 for the pelvis."""

def main(words: Sequence[str], python: str, script: str) -> int:
    """Runs a command line, whose first word is the program, and returns its exit code.

    Child processes of the program are started as ``python script``.
    """

class Motion:
    """A motion of ``L`` frames as SMPL-X parameters, y up, in metres and radians, and the skeleton it drives."""

    def __init__(self, transl: ArrayLike, global_orient: ArrayLike, body_pose: ArrayLike, fps: float) -> None:
        """``transl`` ``[L, 3]``, ``global_orient`` ``[L, 3]`` and ``body_pose`` ``[L, 63]`` as axis-angle."""
    @staticmethod
    def read(path: _Path) -> Motion:
        """Reads a file of any format that ``stance ingest`` knows; ``file.glb#Walking`` names one of several."""
    @staticmethod
    def from_features(features: ArrayLike, recipe: str, first: Motion | None = None) -> Motion:
        """The motion of ``humanml3d`` ``[L, 263]``, ``motionfix`` ``[L, 207]``, ``272`` or ``hy-motion`` ``[L, 201]`` features.

        MotionFix's features are changes, which begin at the first pose of ``first``, or at the rest pose.
        """
    @staticmethod
    def from_joints(joints: ArrayLike, fps: float) -> tuple[Motion, float]:
        """Fits the body to 22 joints ``[L, 22, 3]``; also returns the mean distance left. Both are in metres."""
    def to_amass(self) -> dict[str, Any]:
        """The motion as the arrays of an AMASS archive, z up, with the keys of the SMPL-X release."""
    @staticmethod
    def from_amass(arrays: Mapping[str, Any]) -> Motion:
        """The motion of the arrays of an AMASS archive (SMPL+H or SMPL-X keys, z up), put on the floor."""
    @staticmethod
    def from_amass_bytes(bytes: bytes) -> Motion: ...
    def to_amass_bytes(self) -> bytes: ...
    def __len__(self) -> int: ...
    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]: ...
    def _repr_html_(self) -> str:
        """The clip in 3D, for a notebook; :func:`stance.show` has more."""
    @property
    def fps(self) -> float: ...
    @property
    def duration(self) -> float:
        """Length in seconds."""
    @property
    def content_hash(self) -> str:
        """BLAKE3 of rate and numbers, as in the column of the same name."""
    @property
    def transl(self) -> _F32:
        """``[L, 3]`` in metres."""
    @property
    def global_orient(self) -> _F32:
        """``[L, 3]``, axis-angle."""
    @property
    def body_pose(self) -> _F32:
        """``[L, 63]``, axis-angle of 21 joints."""
    def keypoints(self) -> _F32:
        """Positions of the 28 keypoints, ``[L, 28, 3]`` in metres."""
    def joints(self) -> _F32:
        """Positions of the 22 body joints, ``[L, 22, 3]`` in metres."""
    def features(self, recipe: str) -> _F32:
        """``humanml3d`` ``[L - 1, 263]`` at 20 fps; at 30 fps ``motionfix`` ``[L, 207]``, ``272`` or ``hy-motion`` ``[L, 201]``."""
    def resample(self, fps: float) -> Motion:
        """The motion at another rate, interpolated at exact times."""
    def crop(self, start: int, end: int) -> Motion:
        """Frames ``start`` to ``end``."""

class Dataset:
    def __init__(self, path: _Path, *, verify: bool = True) -> None: ...
    @property
    def path(self) -> os.PathLike[str]: ...
    @property
    def root_hash(self) -> str:
        """Hash of all that the dataset holds."""
    def files(self, table: str, split: str | None = None) -> list[os.PathLike[str]]:
        """Parquet files of a table."""
    def num_rows(self, table: str, split: str | None = None) -> int: ...
    def ids(self, split: str | None = None) -> list[str]:
        """Ids of the clips."""
    def motion(self, id: str) -> Motion:
        """The motion of a clip; only its pages are read."""
    def items(self) -> list[Item]:
        """The test questions of a folder that ``stance items`` wrote."""
    def _manifest(self) -> str: ...
    def _motions_of(self, file: _Path) -> list[tuple[str, Motion]]: ...

class Item:
    """A test question: a motion, an instruction, and the motion that should result."""

    id: str
    task: str
    instruction: str
    parts: list[str]
    joints: list[str]
    """Joints that are edited; empty if unknown."""
    source_id: str
    target_id: str
    source: Motion
    target: Motion | None

class Triplet:
    """An original motion, an instruction, and the edited motion."""

    id: str
    kind: str
    instruction: str
    source_id: str
    target_id: str
    hard_joints: list[str]
    soft_joints: list[str]
    alpha: float
    original: Motion
    edited: Motion
    def _repr_html_(self) -> str:
        """Both motions in 3D, for a notebook."""

class Mix:
    def __init__(self, path: _Path, config: str, seed: int, split: str, normalizer: str | None) -> None: ...
    epoch_len: int
    window_shape: tuple[int, int]
    fps: float
    config: str
    recipe_hash: str
    normalizer: str
    def instructions(self) -> list[str]: ...
    def windows(self, first: int, count: int) -> tuple[_F32, _F32, _F32, list[str]]: ...
    def triplet(self, epoch: int, item: int) -> Triplet: ...
    @staticmethod
    def set_num_threads(count: int) -> None: ...

class Encoder:
    """An encoder of texts and motions, trained by ``stance train tmr``."""

    def __init__(self, run: _Path) -> None: ...
    @property
    def hash(self) -> str: ...
    def encode(self, motions: Sequence[Motion]) -> _F32:
        """Latents of motions, ``[N, D]``."""
    def encode_texts(self, texts: Sequence[str]) -> _F32:
        """Latents of texts, ``[N, D]``."""

def blend(
    source: Motion,
    target: Motion,
    *,
    parts: Sequence[str] | None = None,
    hard: Sequence[str] | None = None,
    soft: Sequence[str] | None = None,
    alpha: float = 0.5,
    official: bool = False,
) -> Motion:
    """Blends two motions of equal length and rate (paper Sec. 4.2).

    Hard joints are those of ``target``, soft ones are interpolated with weight ``alpha``, the rest is ``source``. The
    mask is ``parts`` (``["left arm"]``) or joints by name. ``official`` interpolates as the released code does.
    """

def fid(real: ArrayLike, generated: ArrayLike) -> float:
    """Fréchet distance of latents ``[N, D]`` and ``[M, D]``."""

def diversity(latents: ArrayLike, num_pairs: int = 300, seed: int = 0) -> float:
    """Mean distance of random pairs of latents ``[N, D]``."""

def multimodality(latents: ArrayLike, num_pairs: int = 10, seed: int = 0) -> float:
    """Mean distance of random pairs of the ``R`` takes of a question, over ``N`` questions: ``[N, R, D]``."""

def retrieval(
    queries: ArrayLike, gallery: ArrayLike, gallery_size: int | None = 32, repeats: int = 10, seed: int = 0
) -> dict[str, float]:
    """``R@1``, ``R@2``, ``R@3`` in percent, ``MedR`` and ``AvgR`` (best 1) of paired latents ``[N, D]``, by cosine.

    A gallery holds ``gallery_size`` rows (``None``: all); values are means over ``repeats`` draws.
    """

def foot_score(keypoints: ArrayLike, fps: float, floor: float | None = None) -> float | None:
    """Foot score in (0, 1] of ``[L, 22 or 28, 3]`` in metres, y up; the floor is the lowest foot unless given."""

def position_error(found: ArrayLike, expected: ArrayLike) -> float:
    """Mean distance of keypoints ``[L, 28, 3]`` in metres, over the frames that both have."""

def jerk(keypoints: ArrayLike, fps: float) -> float | None:
    """Mean jerk of keypoints ``[L, 28, 3]`` in m/s³; ``None`` for fewer than four frames."""

def foot_slide(keypoints: ArrayLike, fps: float) -> float | None:
    """Mean horizontal speed of the lowest foot in m/s, of ``[L, 28, 3]``; ``None`` for fewer than two frames."""

def evaluate(
    items: _Path,
    folders: Sequence[_Path],
    systems: Sequence[tuple[str, Sequence[tuple[str, int, Motion]]]],
    encoder: _Path,
    protocol: str,
) -> tuple[str, str]: ...
def ingest(sources: Sequence[_Path], out: _Path, **options: Any) -> str: ...
def masks(dataset: _Path) -> None: ...
def corpus(out: _Path, clips: int | None = None, seed: int = 0) -> None: ...
def viewer_page(motions: Sequence[Motion], labels: Sequence[str], title: str, joints: Sequence[str]) -> str:
    """An HTML page with motions side by side in 3D, without external resources."""
