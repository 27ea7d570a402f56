"""Times of the paper's denoiser in PyTorch, eager and in single precision, measured like ours in `gpu.rs`.

Results are JSON lines on stdout. `gpu.sh` runs it if PyTorch finds a GPU.
"""

import json
import time

import torch
from torch import nn

WIDTH, HEADS, LAYERS, HIDDEN, WINDOW, FRAME = 512, 16, 6, 2048, 16, 84
STEPS, WARM_UP = 20, 3


class Denoiser(nn.Module):
    def __init__(self):
        super().__init__()
        layer = nn.TransformerEncoderLayer(WIDTH, HEADS, HIDDEN, 0.1, activation="gelu", batch_first=True)
        self.encoder = nn.TransformerEncoder(layer, LAYERS)
        self.frames = nn.Linear(FRAME, WIDTH)
        self.original = nn.Linear(FRAME, WIDTH)
        self.step = nn.Sequential(nn.Linear(WIDTH, WIDTH), nn.SiLU(), nn.Linear(WIDTH, WIDTH))
        self.out = nn.Linear(WIDTH, FRAME)

    def forward(self, x, original, text):
        frames = self.frames(x) + self.original(original)
        condition = (self.step(text) + text).unsqueeze(1)
        return self.out(self.encoder(torch.cat([condition, frames], 1))[:, 1:])


def training_step(batch, device):
    model = Denoiser().to(device)
    optimizer = torch.optim.AdamW(model.parameters(), 1e-4)
    host = [torch.randn(batch, WINDOW, FRAME).pin_memory() for _ in range(3)]
    text = torch.randn(batch, WIDTH, device=device)
    for step in range(WARM_UP + STEPS):
        if step == WARM_UP:
            torch.cuda.synchronize()
            begun = time.perf_counter()
        x, original, noise = (values.to(device, non_blocking=True) for values in host)
        loss = (model(x + noise, original, text) - noise).square().mean()
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        optimizer.step()
    torch.cuda.synchronize()
    return (time.perf_counter() - begun) / STEPS


@torch.no_grad()
def sample(batch, device):
    model = Denoiser().to(device).eval()
    original = torch.randn(2 * batch, WINDOW, FRAME, device=device)
    text = torch.randn(2 * batch, WIDTH, device=device)
    for _ in range(2):
        torch.cuda.synchronize()
        begun = time.perf_counter()
        x = torch.randn(batch, WINDOW, FRAME, device=device)
        for _ in range(100):
            with_text, without = model(torch.cat([x, x]), original, text).chunk(2)
            x = 0.99 * x - 0.01 * (without + 4.0 * (with_text - without))
        torch.cuda.synchronize()
    return time.perf_counter() - begun


def main():
    torch.backends.cuda.matmul.allow_tf32 = False
    device = torch.device("cuda")
    for batch in (64, 256, 1024):
        secs = training_step(batch, device)
        print(json.dumps({"what": "training step", "by": "PyTorch", "batch": batch, "secs": secs,
                          "samples_per_sec": batch / secs}))
    for batch in (1, 32, 1024):
        print(json.dumps({"what": "100 guided steps", "by": "PyTorch", "batch": batch, "secs": sample(batch, device)}))


if __name__ == "__main__":
    main()
