"""The example script answers items, and its answers are imported, bundled and scored.

    python check_script.py STANCE ITEMS WORK

The script runs by itself, without the packages of this repository. Its answers to all items are finite, keep
the sources' lengths, and change the items whose instruction names an arm and no others.
"""

import json
import pathlib
import re
import subprocess
import sys

import numpy

STANCE, ITEMS, WORK = map(pathlib.Path, sys.argv[1:])
SCRIPT = pathlib.Path("eval/docs/answer_items.py")
NAME = "Raised arm"


def stance(*args) -> str:
    command = [str(arg) for arg in (STANCE, "--quiet", *args)]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


questions, answers, edits, bundle = (WORK / name for name in ("asked", "given", "edits", "bundle.zip"))
stance("items", "export", ITEMS, "--out", questions)
subprocess.run([sys.executable, "-I", SCRIPT, questions, answers], check=True)

items = json.loads((questions / "items.json").read_text())["items"]
changed = 0
for item in items:
    source = numpy.load(questions / item["source"]["file"])
    answer = numpy.load(answers / f"{item['id']}.npz")
    assert answer["poses"].shape == (item["source"]["frames"], 66), item["id"]
    assert numpy.isfinite(answer["poses"]).all() and numpy.isfinite(answer["trans"]).all(), item["id"]
    assert (answer["trans"] == source["trans"]).all(), item["id"]
    differs = (answer["poses"] != source["poses"][:, :66]).any()
    named = bool({"arm", "arms", "hand", "hands"} & set(re.findall("[a-z]+", item["instruction"].lower())))
    assert differs == named, (item["instruction"], differs)
    changed += differs
assert changed > 0, "no instruction names an arm"

report = json.loads(stance("--json", "edits", "import", answers, "--items", ITEMS, "--name", NAME, "--out", edits))
assert (report["imported"], report["refused"], report["missing"]) == (len(items), [], []), report
stance("edits", "bundle", edits, "--license", "CC0-1.0", "--out", bundle)
measured = ("--encoder", "builtin", "--weak-judge", "--repeats", 2, "--json")
rows = json.loads(stance("eval", bundle, "--items", ITEMS, *measured))
assert rows == json.loads(stance("eval", edits, *measured))
recall = {row["system"]: row["mean"] for row in rows if (row["task"], row["metric"]) == (rows[0]["task"], "E2T R@1")}
print(f"{SCRIPT}: {len(items)} items answered, {changed} changed; R@1 {recall[NAME]:.1f} %, unchanged {recall['Identity']:.1f} %")
