"""Scores a model of your own: python score_model.py ITEMS ENCODER. Items come from `stance items`."""

import sys

import numpy as np
import stance


def my_model(source: stance.Motion, instruction: str) -> stance.Motion:
    """Stands for your model: raises the left arm if the instruction names it, and otherwise changes nothing."""
    if "left arm" not in instruction:
        return source
    pose = source.body_pose.copy()
    # Joint 16 is the left shoulder; the arrays begin at joint 1, after the root.
    pose[:, 15 * 3 : 16 * 3] = np.array([0.0, 0.0, 1.2], np.float32)
    return stance.Motion(source.transl, source.global_orient, pose, source.fps)


items, encoder = sys.argv[1:]
edits = {item.id: my_model(item.source, item.instruction) for item in stance.Dataset(items).items()}
scores = stance.evaluate({"My model": edits}, items, encoder)
print(scores)
print(f"My model finds its text first in {scores.value('My model', 'E2T R@1'):.1f} % of {len(edits)} items")
