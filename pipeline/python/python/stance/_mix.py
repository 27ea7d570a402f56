"""MotionCutMix: composed edits in batches."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from . import _native
from ._dataset import local_path


class Batch(NamedTuple):
    """``B`` windows of ``W`` frames of 28 keypoints in model units (``[-1, 1]`` for the central 95 % of training data)."""

    original: np.ndarray
    """The motions before the edit, ``[B, W, 84]``."""
    edited: np.ndarray
    """The motions after it, ``[B, W, 84]``."""
    progress: np.ndarray
    """Start of each window in its motion, as a fraction of the length, ``[B]``."""
    instructions: list[str]
    """``B`` texts."""


try:
    from torch.utils.data import IterableDataset as _Base
except ImportError:

    class _Base:  # type: ignore[no-redef]
        """Replaces PyTorch's class if PyTorch is not installed."""


class MotionCutMix(_Base):
    """The endless stream of training windows that ``stance train`` sees, bit for bit, in batches.

    Window ``n`` is item ``n % epoch_len`` of epoch ``n // epoch_len``; batch ``k`` begins at window ``k * batch_size``.
    ``epochs`` ends the stream after that number of epochs.

    It is an ``IterableDataset``: ``DataLoader(mix, batch_size=None, num_workers=4)`` gives the same batches in the same
    order as without workers. ``rank`` and ``world_size`` deal batches out to several processes of a distributed run.
    ``state_dict()`` holds the number of the next batch. A loader with workers has read ahead, so count the batches that
    you used, and set ``next_batch`` yourself.

    ``config`` holds settings of the composer, as in section ``compose`` of a plan (``{"mcm_ratio": 0.2}``);
    ``normalizer`` is that of another stream; by default it is fitted to the training split.
    """

    def __init__(
        self,
        dataset: str | os.PathLike[str] | _native.Dataset,
        config: Mapping[str, Any] | None = None,
        seed: int = 0,
        *,
        split: str = "train",
        batch_size: int = 64,
        epochs: int | None = None,
        normalizer: Mapping[str, Any] | None = None,
        rank: int = 0,
        world_size: int = 1,
    ) -> None:
        super().__init__()
        if batch_size < 1:
            raise ValueError(f"batch_size must be at least 1, got {batch_size}")
        if not 0 <= rank < world_size:
            raise ValueError(f"rank must be from 0 to {world_size - 1}, got {rank}")
        self._path = local_path(dataset)
        self._config = dict(config or {})
        self._seed = seed
        self.split = split
        self.batch_size = batch_size
        self.epochs = epochs
        self.rank, self.world_size = rank, world_size
        self.next_batch = 0
        self._normalizer = dict(normalizer) if normalizer else None
        self._mix = self._make()

    def _make(self) -> _native.Mix:
        own = json.dumps(self._normalizer) if self._normalizer else None
        return _native.Mix(self._path, json.dumps(self._config), self._seed, self.split, own)

    # Spawned workers rebuild the stream from its settings; forked ones share its memory.
    def __getstate__(self) -> dict[str, Any]:
        state = dict(self.__dict__)
        del state["_mix"]
        state["_normalizer"] = self.normalizer
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._mix = self._make()

    @property
    def epoch_len(self) -> int:
        """Number of windows of an epoch."""
        return self._mix.epoch_len

    @property
    def window_shape(self) -> tuple[int, int]:
        """``(W, 84)``."""
        return self._mix.window_shape

    @property
    def fps(self) -> float:
        """Frames a second of a window."""
        return self._mix.fps

    @property
    def normalizer(self) -> dict[str, list[float]]:
        """``min`` and ``max`` of each axis in metres, which map to -1 and 1."""
        return json.loads(self._mix.normalizer)

    @property
    def config(self) -> dict[str, Any]:
        """All settings of the composer."""
        return json.loads(self._mix.config)

    @property
    def recipe_hash(self) -> str:
        """Hash of settings and rules: together with dataset and seed, it determines every window."""
        return self._mix.recipe_hash

    @cached_property
    def instructions(self) -> list[str]:
        """Every instruction that a window can have, sorted."""
        return self._mix.instructions()

    def windows(self, first: int, count: int) -> Batch:
        """Windows ``first`` to ``first + count`` of the stream."""
        return Batch(*self._mix.windows(first, count))

    def triplet(self, epoch: int, item: int) -> _native.Triplet:
        """The whole clips that a window of an item is cut from: original, instruction, edited motion."""
        return self._mix.triplet(epoch, item)

    def to_metres(self, windows: np.ndarray) -> np.ndarray:
        """Converts windows ``[..., 84]`` in model units to keypoints ``[..., 28, 3]`` in metres."""
        low, high = (np.asarray(self.normalizer[end], np.float32) for end in ("min", "max"))
        points = np.asarray(windows).reshape(*np.shape(windows)[:-1], 28, 3)
        return (points + 1) / 2 * (high - low) + low

    @property
    def num_batches(self) -> int | None:
        """Number of batches of the stream, of all ranks together; ``None`` if it is endless."""
        if self.epochs is None:
            return None
        return -(-self.epochs * self.epoch_len // self.batch_size)

    def __iter__(self) -> Iterator[Batch]:
        worker, num_workers = 0, 1
        try:
            from torch.utils.data import get_worker_info
        except ImportError:
            pass
        else:
            if (info := get_worker_info()) is not None:
                worker, num_workers = info.id, info.num_workers
                _native.Mix.set_num_threads(1)
        # This rank's batches from the next one on, dealt out to its workers in turn, as a loader collects them.
        first_batch = self.next_batch + (self.rank - self.next_batch) % self.world_size
        ahead = worker * self.world_size
        k = first_batch + ahead
        while self.num_batches is None or k < self.num_batches:
            first = k * self.batch_size
            count = self.batch_size
            if self.epochs is not None:
                count = min(count, self.epochs * self.epoch_len - first)
            batch = self.windows(first, count)
            k += num_workers * self.world_size
            # All workers of a loader have the same number here, so any of their states can be saved.
            self.next_batch = k - ahead
            yield batch
        self.next_batch = 0

    def state_dict(self) -> dict[str, Any]:
        """The number of the next batch, and the settings that determine its content."""
        return {"next_batch": self.next_batch, "batch_size": self.batch_size, "recipe_hash": self.recipe_hash, "seed": self._seed}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continues from a state; raises ``ValueError`` if it was saved with other settings."""
        own = self.state_dict()
        for key in ("batch_size", "recipe_hash", "seed"):
            if state[key] != own[key]:
                raise ValueError(f"the state was saved with {key} {state[key]!r}, this stream has {own[key]!r}")
        self.next_batch = int(state["next_batch"])

    def __repr__(self) -> str:
        return f"MotionCutMix({self._path!r}, {self.split}, {self.epoch_len} windows an epoch)"
