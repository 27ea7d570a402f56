"""Kills the command at random moments, and looks at what it left.

    python3 tests/kills/campaign.py STANCE [--kills 200] [--seed 1] [--seconds 1500]

Grows, prunes, compacts, restores and merges small datasets. Each run gets SIGKILL after a random share of the time
that an undisturbed run takes. It must leave either the version before it or the version after it, complete. The same
command must then succeed and lead to the version after, and a search for Parquet files must find only the files of
that version. Needs only Python.
"""

import argparse
import json
import random
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

VERBS = ("grow", "prune", "compact", "restore", "merge")


class Campaign:
    def __init__(self, stance: str, work: Path, seed: int):
        self.stance, self.work = stance, work
        self.random = random.Random(seed)
        self.source, self.base, self.other = work / "corpus", work / "base", work / "other"
        self.run("corpus", "--clips", "20", "--out", self.source)
        waiting = self.take_away(11)
        self.run("ingest", self.source, "--out", self.base)
        for count in (1, 1, 1, 2):
            self.bring_back(waiting, count)
            self.run("ingest", self.source, "--out", self.base)
        self.run("masks", self.base)
        self.run("ingest", self.source, "--out", self.other, "--seed", "5")
        self.bring_back(waiting, len(waiting))
        self.before = self.root_hash(self.base)

    def run(self, *args, check=True):
        done = subprocess.run([self.stance, *map(str, args)], capture_output=True, text=True)
        if check and done.returncode != 0:
            raise AssertionError(f"{args} ended with {done.returncode}: {done.stderr}")
        return done

    def take_away(self, count: int) -> list:
        files = sorted(path for end in ("bvh", "npz") for path in self.source.rglob(f"*.{end}"))
        taken = []
        for file in files[:: max(1, len(files) // count)][:count]:
            beside = [path for path in file.parent.iterdir() if path.name.startswith(f"{file.stem}.")]
            taken.append([(path, path.read_bytes()) for path in sorted(beside)])
            for path in beside:
                path.unlink()
        return taken

    def bring_back(self, waiting: list, count: int) -> None:
        for files in [waiting.pop() for _ in range(count)]:
            for path, content in files:
                path.write_bytes(content)

    def manifest(self, dataset: Path) -> dict:
        manifests = dataset.glob("meta/manifest-*.json")
        return json.loads(max(manifests, key=lambda path: int(path.stem.rsplit("-", 1)[1])).read_text())

    def root_hash(self, dataset: Path) -> str:
        return json.loads(self.run("--json", "inspect", dataset).stdout)["root_hash"]

    def command(self, verb: str, dataset: Path) -> list:
        return {
            "grow": ["ingest", self.source, "--out", dataset],
            "prune": ["dataset", "prune", dataset],
            "compact": ["dataset", "compact", dataset],
            "restore": ["dataset", "restore", dataset, "--to", "1", "--drop-labels"],
            "merge": ["dataset", "merge", self.base, self.other, "--out", dataset],
        }[verb]

    def prepare(self, verb: str, name: str) -> Path:
        dataset = self.work / name
        if verb != "merge":
            shutil.copytree(self.base, dataset)
        return dataset

    def clean(self, verb: str) -> tuple:
        """Root hash after an undisturbed run, and its time."""
        dataset = self.prepare(verb, f"clean-{verb}")
        started = time.monotonic()
        self.run(*self.command(verb, dataset))
        seconds = time.monotonic() - started
        after = self.root_hash(dataset)
        shutil.rmtree(dataset)
        return after, seconds

    def kill(self, verb: str, after: str, seconds: float) -> str:
        """Kills a run; returns what it left: before, after, or that it had ended."""
        dataset = self.prepare(verb, "killed")
        args = [self.stance, *map(str, self.command(verb, dataset))]
        child = subprocess.Popen(args, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        time.sleep(self.random.random() * seconds)
        child.kill()
        ended = child.wait() >= 0
        if verb == "merge" and not list(dataset.glob("meta/manifest-*.json")):
            left = "before"
        else:
            found = self.root_hash(dataset)
            assert found in (self.before, after), f"{verb} left neither version: {found}"
            assert verb != "merge" or found == after, f"{verb} left something else"
            self.run("verify", dataset)
            left = "after" if found == after and (verb != "prune" or self.is_pruned(dataset)) else "before"
        if verb == "merge" and left == "after":
            # The dataset exists, and nothing is half done.
            self.run("dataset", "prune", dataset)
        else:
            self.run(*self.command(verb, dataset))
        assert self.root_hash(dataset) == after, f"{verb} ended elsewhere after a kill"
        named = {file["path"] for files in self.manifest(dataset)["tables"].values() for file in files}
        found = {str(path.relative_to(dataset)) for path in dataset.rglob("*.parquet")}
        assert found == named, f"{verb}: a search finds {found ^ named}"
        half_written = list(dataset.rglob(".*.tmp"))
        assert not half_written, f"{verb}: {half_written}"
        self.run("verify", dataset)
        shutil.rmtree(dataset)
        return "ended" if ended else left

    def is_pruned(self, dataset: Path) -> bool:
        return len(list(dataset.glob("meta/manifest-*.json"))) == 1


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("stance")
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=1500)
    options = parser.parse_args()
    started = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        campaign = Campaign(options.stance, Path(folder), options.seed)
        clean = {verb: campaign.clean(verb) for verb in VERBS}
        counts = {verb: {"before": 0, "after": 0, "ended": 0} for verb in VERBS}
        killed, turn = 0, 0
        while killed < options.kills:
            if time.monotonic() - started > options.seconds:
                sys.exit(f"only {killed} kills in {options.seconds:.0f} seconds")
            verb = VERBS[turn % len(VERBS)]
            turn += 1
            left = campaign.kill(verb, *clean[verb])
            counts[verb][left] += 1
            killed += left != "ended"
    print(f"{killed} kills in {time.monotonic() - started:.0f} seconds; every one left the version before or after")
    for verb, count in counts.items():
        print(f"  {verb:<8} before {count['before']:>3}  after {count['after']:>3}  ended before the kill {count['ended']:>3}")


main()
