"""Imported by lerobot for training."""


class Accelerator:
    pass
