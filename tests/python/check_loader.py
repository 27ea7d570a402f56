"""Checks MotionCutMix in loaders of PyTorch: python check_loader.py DATASET."""

import sys
from itertools import islice

import stance
import torch
from torch.utils.data import DataLoader, IterableDataset


def main() -> None:
    mix = stance.MotionCutMix(sys.argv[1], seed=3, batch_size=16)
    assert isinstance(mix, IterableDataset)
    alone = [mix.windows(16 * k, 16) for k in range(9)]
    for workers in (0, 1, 2, 3):
        for start in ("fork", "spawn") if workers == 2 else ("fork",):
            own = stance.MotionCutMix(sys.argv[1], seed=3, batch_size=16)
            loader = DataLoader(own, batch_size=None, num_workers=workers, multiprocessing_context=start if workers else None)
            for k, batch in enumerate(islice(loader, 9)):
                assert isinstance(batch, stance.Batch) and batch.edited.dtype == torch.float32
                assert torch.equal(batch.original, torch.from_numpy(alone[k].original)), (workers, start, k)
                assert torch.equal(batch.edited, torch.from_numpy(alone[k].edited)), (workers, start, k)
                assert batch.instructions == alone[k].instructions
            assert k == 8
    # A loader continues after the batches that were used.
    own = stance.MotionCutMix(sys.argv[1], seed=3, batch_size=16)
    own.next_batch = 5
    resumed = next(iter(DataLoader(own, batch_size=None, num_workers=2)))
    assert torch.equal(resumed.edited, torch.from_numpy(alone[5].edited))
    print("loaders of PyTorch give the same batches with any number of workers")


# Spawned workers import this file.
if __name__ == "__main__":
    main()
