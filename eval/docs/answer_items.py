"""Answers exported items without the program's own code: a template for a model of any framework.

    stance items export ITEMS --out QUESTIONS
    python answer_items.py QUESTIONS ANSWERS
    stance edits import ANSWERS --items ITEMS --name "Raised arm" --out EDITS

It reads the source and the instruction of each item. If the instruction names an arm, that arm is raised;
otherwise the source is returned. If an item asks about only some frames, the others stay. Replace `edited` by your
model.
"""

import json
import pathlib
import sys

import numpy

# Indices of the shoulders among the 21 body joints of SMPL-X, and the rotation about the forward axis to raise an arm.
SHOULDERS = {"left": (15, 1.2), "right": (16, -1.2)}


def edited(poses: numpy.ndarray, trans: numpy.ndarray, instruction: str):
    """Poses [T, 66] and translations [T, 3] of the edit; the first 3 numbers of a pose rotate the root."""
    poses = poses.copy()
    words = instruction.lower().replace(".", " ").replace(",", " ").split()
    if {"arm", "arms", "hand", "hands"} & set(words):
        named = [side for side in SHOULDERS if side in words]
        for side in named or SHOULDERS:
            joint, turn = SHOULDERS[side]
            poses[:, 3 + 3 * joint : 6 + 3 * joint] = (0.0, 0.0, turn)
    return poses, trans


def main(questions: pathlib.Path, answers: pathlib.Path) -> None:
    answers.mkdir(parents=True)
    for item in json.loads((questions / "items.json").read_text())["items"]:
        source = numpy.load(questions / item["source"]["file"])
        poses, trans = source["poses"][:, :66], source["trans"]
        # Frames around the asked ones stay; an answer about all frames may have another length than the source.
        start, end = item.get("edit_start", 0), item.get("edit_end", len(trans))
        answer = edited(poses[start:end], trans[start:end], item["instruction"])
        parts = zip((poses, trans), answer)
        poses, trans = (numpy.concatenate([whole[:start], part, whole[end:]]) for whole, part in parts)
        numpy.savez(answers / f"{item['id']}.npz", poses=poses, trans=trans, mocap_frame_rate=item["fps"])


if __name__ == "__main__":
    main(*map(pathlib.Path, sys.argv[1:]))
