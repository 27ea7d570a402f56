"""Runs the two readers of datasets-spec/docs/python.md and counts the windows each gives in a second.

    python check_reading.py DATASET

Both must yield the same clips, and the one that is called fast must be.
"""

import pathlib
import re
import sys
import time

import numpy

DOCUMENT = pathlib.Path(__file__).parents[2] / "datasets-spec" / "docs" / "python.md"
WINDOW = 60
ROUNDS = 3


def readers() -> tuple:
    names = {}
    for script in re.findall(r"```python\n(.*?)```", DOCUMENT.read_text(), re.DOTALL):
        exec(script, names)
    return names["clips_of_datasets"], names["clips_of_pyarrow"]


def windows_per_second(reader, folder: str) -> float:
    """Windows per second of processor time, which other programs do not affect; the best of ROUNDS. A window of each
    clip is read at a random place, as in training."""
    best = 0.0
    for seed in range(ROUNDS):
        rng = numpy.random.default_rng(seed)
        windows, started = 0, time.process_time()
        for _, frames in reader(folder):
            start = rng.integers(0, max(1, len(frames) - WINDOW))
            windows += len(frames[start : start + WINDOW].copy()) > 0
        best = max(best, windows / (time.process_time() - started))
    return best


def main() -> None:
    folder = sys.argv[1]
    obvious, fast = readers()
    expected, found = dict(obvious(folder)), dict(fast(folder))
    assert expected.keys() == found.keys() and expected, (len(expected), len(found))
    for name, frames in expected.items():
        assert frames.dtype == found[name].dtype == numpy.float32, (frames.dtype, found[name].dtype)
        assert numpy.array_equal(frames, found[name]), name
    slow, quick = windows_per_second(obvious, folder), windows_per_second(fast, folder)
    print(f"windows of {WINDOW} frames in a second of the processor: {slow:.0f} with datasets, {quick:.0f} with pyarrow")
    assert quick > slow, "the document says otherwise"


main()
