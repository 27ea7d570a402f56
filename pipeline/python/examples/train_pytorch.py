"""Trains a small denoiser on MotionCutMix in plain PyTorch: python train_pytorch.py DATASET [--steps N]."""

import argparse
import math

import stance
import torch
from torch import nn
from torch.utils.data import DataLoader


class Denoiser(nn.Module):
    """Predicts a clean edited window from a noisy one, the original, the noise level and the instruction."""

    def __init__(self, words: list[str], frame: int = 84, width: int = 128) -> None:
        super().__init__()
        self.index = {word: number for number, word in enumerate(words)}
        self.words = nn.EmbeddingBag(len(words), width)
        self.level = nn.Linear(1, width)
        self.frames = nn.Linear(2 * frame, width)
        layer = nn.TransformerEncoderLayer(width, 4, 2 * width, batch_first=True, norm_first=True)
        self.layers = nn.TransformerEncoder(layer, 3, enable_nested_tensor=False)
        self.out = nn.Linear(width, frame)

    def forward(self, noisy, original, level, texts):
        numbers = [torch.tensor([self.index[word] for word in text.split()]) for text in texts]
        starts = torch.tensor([0] + [len(text) for text in numbers[:-1]]).cumsum(0)
        said = self.words(torch.cat(numbers), starts) + self.level(level)
        tokens = self.frames(torch.cat([noisy, original], -1))
        return self.out(self.layers(torch.cat([said[:, None], tokens], 1))[:, 1:])


def train(dataset: str, steps: int, workers: int) -> list[float]:
    mix = stance.MotionCutMix(dataset, seed=0, batch_size=64)
    batches = iter(DataLoader(mix, batch_size=None, num_workers=workers))
    model = Denoiser(sorted({word for text in mix.instructions for word in text.split()}))
    optimizer = torch.optim.AdamW(model.parameters(), lr=3e-4)
    losses = []
    for step in range(steps):
        batch = next(batches)
        # A variance-preserving cosine schedule; the network predicts the clean window.
        level = torch.rand(len(batch.edited), 1)
        keep, noise = (torch.cos(level * math.pi / 2)[..., None], torch.sin(level * math.pi / 2)[..., None])
        noisy = keep * batch.edited + noise * torch.randn_like(batch.edited)
        loss = nn.functional.mse_loss(model(noisy, batch.original, level, batch.instructions), batch.edited)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
        if step % 20 == 0:
            print(f"step {step:5} loss {losses[-1]:.4f}")
    return losses


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("dataset")
    parser.add_argument("--steps", type=int, default=200)
    parser.add_argument("--workers", type=int, default=1)
    given = parser.parse_args()
    torch.manual_seed(0)
    losses = train(given.dataset, given.steps, given.workers)
    tenth = max(1, len(losses) // 10)
    first, last = sum(losses[:tenth]) / tenth, sum(losses[-tenth:]) / tenth
    print(f"mean loss of the first tenth {first:.4f}, of the last {last:.4f}")
