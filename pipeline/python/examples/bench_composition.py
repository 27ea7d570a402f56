"""Compares windows a second of MotionCutMix with the same composition in PyTorch and roma, each on one core.

python bench_composition.py DATASET [--seconds S]. Both give batches of 64 windows as tensors. The one in PyTorch is a
plain dataset: it keeps rotations in memory, blends two stretches for an item, and runs forward kinematics on whole
batches. Before measuring, the script checks that both agree.
"""

import argparse
import time

import numpy as np
import roma
import stance
import torch

WINDOW, BATCH = 16, 64
# Parents of the 28 keypoints (pelvis to wrists, eyes, index and ring knuckles of either hand).
PARENTS = [-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 15, 15, 20, 20, 21, 21]


def rest_points() -> torch.Tensor:
    """Keypoints of the body at rest, ``[28, 3]``."""
    still = stance.Motion(np.zeros((1, 3)), np.zeros((1, 3)), np.zeros((1, 63)), 20)
    return torch.from_numpy(still.keypoints()[0])


class Composer:
    """Blending, forward kinematics, canonical frame and normalisation of one window."""

    def __init__(self, normalizer: dict) -> None:
        rest = rest_points()
        self.root = rest[0]
        self.offsets = [rest[joint] - rest[max(parent, 0)] for joint, parent in enumerate(PARENTS)]
        self.low = torch.tensor(normalizer["min"], dtype=torch.float32)
        self.range = torch.tensor(normalizer["max"], dtype=torch.float32) - self.low

    def window(self, transl: torch.Tensor, rotations: torch.Tensor) -> torch.Tensor:
        """The window ``[..., W, 84]`` in model units, from translations and local quaternions ``[..., W, 22, 4]``."""
        turns, points = [rotations[..., 0, :]], [transl + self.root]
        for joint in range(1, 28):
            parent = PARENTS[joint]
            points.append(points[parent] + roma.quat_action(turns[parent], self.offsets[joint].expand(transl.shape)))
            turns.append(roma.quat_product(turns[parent], rotations[..., joint, :]) if joint < 22 else None)
        points = torch.stack(points, -2)
        facing = roma.unitquat_to_rotmat(rotations[..., 0, 0, :])
        yaw = torch.atan2(facing[..., 0, 2], facing[..., 2, 2])
        back = roma.rotvec_to_rotmat(torch.stack([yaw * 0, -yaw, yaw * 0], -1))
        points = points - points[..., :1, :1, :] * torch.tensor([1.0, 0.0, 1.0])
        points = points @ back.transpose(-1, -2).unsqueeze(-3)
        return (2 * (points - self.low) / self.range - 1).flatten(-2)

    def blend(self, source, target, hard: list[int], soft: list[int], alpha: float):
        """Hard joints come from the target, soft ones are interpolated, the rest comes from the source."""
        transl, rotations = source[0], source[1].clone()
        rotations[:, hard] = target[1][:, hard]
        rotations[:, soft] = roma.unitquat_slerp(source[1][:, soft], target[1][:, soft], torch.tensor([alpha]))[0]
        return (target[0] if 0 in hard else transl), rotations


def loaded(motion: stance.Motion) -> tuple[torch.Tensor, torch.Tensor]:
    """Translations ``[L, 3]`` and local quaternions ``[L, 22, 4]`` of a motion."""
    vectors = np.concatenate([motion.global_orient, motion.body_pose], 1).reshape(len(motion), 22, 3)
    return torch.from_numpy(motion.transl), roma.rotvec_to_unitquat(torch.from_numpy(vectors))


NAMES = (
    "pelvis left_hip right_hip spine1 left_knee right_knee spine2 left_ankle right_ankle spine3 left_foot right_foot neck "
    "left_collar right_collar head left_shoulder right_shoulder left_elbow right_elbow left_wrist right_wrist"
).split()


def indices(names: list[str]) -> list[int]:
    return [NAMES.index(name) for name in names]


def stretch(clip, start: int, span: int, stride: int):
    """The frames of a window, taken from a clip."""
    return tuple(part[start : start + span : stride] for part in clip)


class Windows(torch.utils.data.Dataset):
    """Semantic edits: an item blends a stretch of an annotated clip with one of a random partner."""

    def __init__(self, path: str, composer: Composer, stride: int) -> None:
        dataset = stance.Dataset(path)
        self.span = (WINDOW - 1) * stride + 1
        self.stride, self.composer = stride, composer
        clips = {id: loaded(motion) for id, motion in dataset.motions("train") if len(motion) >= self.span}
        self.base = list(clips.values())
        masks = dataset.table("masks", "train").to_pylist()
        self.masks = [(clips[mask["motion_id"]], mask) for mask in masks if mask["motion_id"] in clips]
        self.joints = [(indices(mask["hard_joints"]), indices(mask["soft_joints"])) for _, mask in self.masks]

    def __len__(self) -> int:
        return len(self.masks)

    def __getitem__(self, index: int):
        target, mask = self.masks[index]
        source = self.base[int(torch.randint(len(self.base), ()))]
        first, second = (int(torch.randint(len(clip[0]) - self.span + 1, ())) for clip in (source, target))
        source, target = (stretch(clip, at, self.span, self.stride) for clip, at in ((source, first), (target, second)))
        edited = self.composer.blend(source, target, *self.joints[index], float(torch.rand(())))
        return source, edited, mask["text"]

    def collate(self, items):
        """Original and edited windows ``[B, W, 84]``, and the instructions."""
        sources, edits, texts = zip(*items)
        sides = [[torch.stack(part) for part in zip(*side)] for side in (sources, edits)]
        return *(self.composer.window(*side) for side in sides), list(texts)


def check(mix: stance.MotionCutMix, path: str, composer: Composer, stride: int) -> None:
    """Asserts that this file makes the windows of the stream from the same two clips, joints and weight."""
    dataset, span = stance.Dataset(path), (WINDOW - 1) * stride + 1
    batch = mix.windows(0, 12)

    def nearest(window: np.ndarray, make, clip) -> tuple[float, int]:
        """Distance from a window to the stretch of a clip that gives it best, and the start of that stretch."""
        wanted = torch.from_numpy(window)
        starts = range(len(clip[0]) - span + 1)
        return min((float((make(stretch(clip, at, span, stride)) - wanted).abs().max()), at) for at in starts)

    for item in range(12):
        triplet = mix.triplet(0, item)
        source, target = (loaded(dataset[id]) for id in (triplet.source_id, triplet.target_id))
        apart, start = nearest(batch.original[item], lambda part: composer.window(*part), source)
        under = stretch(source, start, span, stride)
        mask = indices(triplet.hard_joints), indices(triplet.soft_joints), triplet.alpha
        edited, _ = nearest(batch.edited[item], lambda part: composer.window(*composer.blend(under, part, *mask)), target)
        # Tolerance: single precision over a chain of eight joints, at coordinates of about a metre.
        assert max(apart, edited) < 1e-4, (item, apart, edited)


def rate(batches, seconds: float) -> float:
    """Windows per second of processor time of a loop over batches of 64."""
    count, begun = 0, time.process_time()
    for original, _edited, _texts in batches:
        assert isinstance(original, torch.Tensor) and original.shape == (BATCH, WINDOW, 84)
        count += BATCH
        if (taken := time.process_time() - begun) > seconds:
            return count / taken
    raise AssertionError("the stream is endless")


def ours(mix: stance.MotionCutMix):
    for batch in mix:
        yield torch.from_numpy(batch.original), torch.from_numpy(batch.edited), batch.instructions


def theirs(windows: Windows):
    while True:
        sampler = torch.utils.data.RandomSampler(windows, replacement=True, num_samples=1 << 20)
        yield from torch.utils.data.DataLoader(windows, BATCH, sampler=sampler, collate_fn=windows.collate)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("dataset")
    parser.add_argument("--seconds", type=float, default=10)
    given = parser.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(0)
    mix = stance.MotionCutMix(given.dataset, {"kinds": ["semantic"]}, batch_size=BATCH)
    mix._mix.set_num_threads(1)
    stride = round(stance.Dataset(given.dataset)[stance.Dataset(given.dataset).ids()[0]].fps / mix.fps)
    composer = Composer(mix.normalizer)
    check(mix, given.dataset, composer, stride)
    windows = Windows(given.dataset, composer, stride)
    # Measured alternately, so that both run under the same conditions.
    pairs = [(rate(ours(mix), given.seconds / 4), rate(theirs(windows), given.seconds / 4)) for _ in range(2)]
    a, b = (max(pair[side] for pair in pairs) for side in (0, 1))
    print(f"windows a second of one core: stance {a:,.0f}, PyTorch and roma {b:,.0f}; {a / b:.0f} times as many")
