"""Reads the losses of a run with TensorBoard and compares them with the metrics file.

    python check_events.py RUN
"""

import json
import pathlib
import struct
import sys

from tensorboard.backend.event_processing.event_accumulator import EventAccumulator


def main() -> None:
    run = pathlib.Path(sys.argv[1])
    events = EventAccumulator(str(run))
    events.Reload()
    expected = {}
    for line in (run / "metrics.jsonl").read_text().splitlines():
        fields = json.loads(line)
        step = fields.pop("step")
        for name, value in fields.items():
            if isinstance(value, (int, float)) and not isinstance(value, bool):
                # An event has single precision.
                (single,) = struct.unpack("<f", struct.pack("<f", value))
                expected.setdefault(name, []).append((step, single))
    found = {
        name: [(event.step, event.value) for event in events.Scalars(name)]
        for name in events.Tags()["scalars"]
    }
    assert {"loss", "val_loss"} <= found.keys(), found.keys()
    assert found == expected, (found, expected)
    print(f"TensorBoard reads {sum(map(len, found.values()))} numbers of {len(found)} curves as the metrics file has them")


main()
