"""Answers written in Python score exactly as the same edits made by the program.

    python check_answers.py STANCE ITEMS EDITS ENCODER WORK

EDITS answer ITEMS. They are written again as Parquet by pyarrow, as npz and as pickled dictionaries by
NumPy, imported under other names and scored beside the first. Where PyTorch is installed, the script
of eval/docs/score.md runs as it stands, with a model that changes nothing.
"""

import importlib.util
import json
import math
import pathlib
import re
import subprocess
import sys

import numpy
import pyarrow
import pyarrow.parquet

STANCE, ITEMS, EDITS, ENCODER, WORK = map(pathlib.Path, sys.argv[1:])
MOTION = ("transl", "global_orient", "body_pose")
RECORDED = ("Fit error", "Bone drift")
MODEL = """
import torch

class Same(torch.nn.Module):
    def forward(self, poses, trans, instruction):
        return poses, trans

model = Same()
"""


def stance(*args) -> str:
    command = [str(arg) for arg in (STANCE, "--quiet", *args)]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def imported(answers: pathlib.Path, name: str) -> pathlib.Path:
    out = WORK / f"edits-{name}"
    stance("edits", "import", answers, "--items", ITEMS, "--name", name, "--out", out)
    return out


def scores(rows: list[dict], system: str) -> dict:
    return {
        (row["task"], row["metric"]): row["mean"]
        for row in rows
        if row["system"] == system and not row["metric"].startswith(RECORDED)
    }


def evaluate(*folders: pathlib.Path) -> list[dict]:
    args = ("--encoder", ENCODER, "--repeats", 2, "--further", "--format", "json")
    return json.loads(stance("eval", "--weak-judge", *args, *folders))


def write_parquet(rows: list[dict], path: pathlib.Path) -> None:
    answers = [
        {"id": row["id"], "fps": row["fps"], **{key: numpy.float64(row[key]).tolist() for key in MOTION}}
        for row in rows
    ]
    pyarrow.parquet.write_table(pyarrow.Table.from_pylist(answers), path)


def write_npz(rows: list[dict], folder: pathlib.Path) -> None:
    folder.mkdir()
    for row in rows:
        arrays = {key: numpy.float32(row[key]) for key in MOTION}
        numpy.savez(folder / f"{row['id']}.npz", fps=row["fps"], **arrays)


def write_dictionaries(rows: list[dict], folder: pathlib.Path) -> None:
    folder.mkdir()
    for row in rows:
        numpy.save(folder / f"{row['id']}.npy", {key: numpy.float32(row[key]) for key in MOTION})


def check_readme() -> None:
    """Runs the script of eval/docs/score.md with a model that returns its input."""
    (WORK / "model.py").write_text(MODEL)
    document = pathlib.Path(__file__).parents[2] / "eval" / "docs" / "score.md"
    (script,) = re.findall(r"```python\n(.*?)```", document.read_text(), re.DOTALL)
    (WORK / "answer.py").write_text(script)
    stance("items", "export", ITEMS, "--out", WORK / "questions")
    subprocess.run([sys.executable, "answer.py", "questions", "answers"], cwd=WORK, check=True)
    rows = evaluate(imported(WORK / "answers", "Same"))
    same, identity = scores(rows, "Same"), scores(rows, "Identity")
    assert same.keys() == identity.keys(), (same.keys(), identity.keys())
    for key, value in same.items():
        # The script rounds to single precision; the program rotates in double precision.
        assert math.isclose(value, identity[key], rel_tol=1e-3, abs_tol=1e-3), (key, value, identity[key])
    print(f"{len(same)} scores of the script are those of the identity")


def main() -> None:
    shards = sorted((EDITS / "data" / "edits").glob("*.parquet"))
    rows = [row for shard in shards for row in pyarrow.parquet.read_table(shard).to_pylist()]
    (system,) = {row["system"] for row in rows}
    write_parquet(rows, WORK / "answers.parquet")
    write_npz(rows, WORK / "archives")
    write_dictionaries(rows, WORK / "dictionaries")
    answers = {"pyarrow": "answers.parquet", "npz": "archives", "npy": "dictionaries"}
    table = evaluate(EDITS, *(imported(WORK / files, name) for name, files in answers.items()))
    ours = scores(table, system)
    assert len(ours) > 10, ours
    for name in answers:
        assert scores(table, name) == ours, (name, scores(table, name), ours)
    print(f"{len(ours)} scores of {len(rows)} edits are the same from {', '.join(answers)}")
    if importlib.util.find_spec("torch"):
        check_readme()
    else:
        print("SKIPPED the script of eval/docs/score.md: PyTorch is not installed here", file=sys.stderr)


main()
