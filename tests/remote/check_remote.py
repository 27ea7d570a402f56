"""Datasets and sources at URLs, against a real S3 server behind a proxy that injects faults.

usage: check_remote.py STANCE WORK, where STANCE is the program and WORK an empty folder
"""

from __future__ import annotations

import functools
import http.client
import http.server
import json
import logging
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
import traceback
from pathlib import Path

from moto.server import ThreadedMotoServer
from proxy import Faults, Proxy, Request

STANCE, WORK = Path(sys.argv[1]).resolve(), Path(sys.argv[2]).resolve()
BUCKET = "clips"
FAULTS = Faults(delay=0.01, unavailable=9, cut=5, lost=11)
#: Authorization header: the server takes the owner of an object from it, and checks no signature.
OWNER = "AWS4-HMAC-SHA256 Credential=test/20260101/us-east-1/s3/aws4_request, SignedHeaders=host, Signature=0"
OK, FAILED, USAGE, QUARANTINED, LOCKED = 0, 1, 2, 3, 75


def variables(proxy: Proxy) -> dict[str, str]:
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("AWS_", "STANCE_", "HF_"))}
    return kept | {
        "AWS_ACCESS_KEY_ID": "test",
        "AWS_SECRET_ACCESS_KEY": "test",
        "AWS_REGION": "us-east-1",
        "AWS_ENDPOINT_URL": proxy.url,
        "STANCE_CACHE": str(WORK / "cache"),
        "STANCE_REMOTE_RETRIES": "6",
        "HF_HOME": str(WORK / "hub"),
    }


class Bench:
    def __init__(self) -> None:
        logging.getLogger("werkzeug").setLevel(logging.ERROR)
        self.server = ThreadedMotoServer("127.0.0.1", port=0, verbose=False)
        self.server.start()
        self.host, self.port = self.server.get_host_and_port()
        self.proxy = Proxy(self.host, self.port)
        self.request("PUT", f"/{BUCKET}")

    def request(self, method: str, path: str, body: bytes = b"") -> bytes:
        """Sends a request directly to the server, past the proxy and its faults."""
        connection = http.client.HTTPConnection(self.host, self.port, timeout=60)
        connection.request(method, path, body, {"Authorization": OWNER})
        answer = connection.getresponse()
        content = answer.read()
        assert answer.status < 300, (method, path, answer.status, content)
        return content

    def upload(self, folder: Path, prefix: str) -> str:
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                self.request("PUT", f"/{BUCKET}/{prefix}/{path.relative_to(folder).as_posix()}", path.read_bytes())
        return f"s3://{BUCKET}/{prefix}"

    def keys(self, prefix: str) -> list[str]:
        text = self.request("GET", f"/{BUCKET}?list-type=2&prefix={prefix}/").decode()
        return [key.removeprefix(f"{prefix}/") for key in re.findall(r"<Key>(.*?)</Key>", text)]

    def start(self, *words: object, **more: str) -> subprocess.Popen[bytes]:
        command = [str(STANCE), *(str(word) for word in words), "--no-progress"]
        environment = variables(self.proxy) | more
        return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment)

    def run(self, *words: object, code: int = OK, **more: str) -> subprocess.CompletedProcess[str]:
        process = self.start(*words, **more)
        out, err = (text.decode() for text in process.communicate())
        line = " ".join(str(word) for word in words)
        assert process.returncode == code, f"stance {line}: exit {process.returncode}, expected {code}\n{out}\n{err}"
        return subprocess.CompletedProcess(line, code, out, err)

    def json(self, *words: object, code: int = OK, **more: str) -> dict:
        return json.loads(self.run(*words, "--json", code=code, **more).stdout)

    def clean_cache(self) -> None:
        shutil.rmtree(WORK / "cache", ignore_errors=True)

    def data_files(self, prefix: str) -> list[str]:
        return [key for key in self.keys(prefix) if key.startswith("data/")]


TESTS = []


def test(function):
    TESTS.append(function)
    return function


def balanced(report: dict) -> None:
    assert report["sources"] == report["ingested"] + report["quarantined"] + report["skipped"], report
    assert report["quarantined"] == sum(report["codes"].values()), report


@test
def ingestion_gives_the_root_hash_of_a_disk_with_faults_and_without(bench: Bench) -> None:
    assert bench.local["ingested"] > 20 and bench.local["quarantined"] == 1
    cases = [
        ("plain", bench.source, f"s3://{BUCKET}/plain", Faults()),
        ("faulty", bench.source, f"s3://{BUCKET}/faulty", FAULTS),
        ("up", WORK / "source", f"s3://{BUCKET}/up", FAULTS),
        ("down", bench.source, WORK / "down", FAULTS),
    ]
    for name, source, out, faults in cases:
        bench.clean_cache()
        bench.proxy.reset(faults)
        report = bench.json("ingest", source, "--out", out, code=QUARANTINED)
        balanced(report)
        assert report["root_hash"] == bench.local["root_hash"], name
        assert report["codes"] == bench.local["codes"], name
        if faults is FAULTS:
            assert bench.proxy.count > 50, "faults were met"
        again = bench.json("ingest", source, "--out", out, code=QUARANTINED)
        assert again["already_complete"] and again["root_hash"] == bench.local["root_hash"], name
        if name != "down":
            files = bench.keys(name)
            # `.stance/` records the paths of sources.
            others = [key for key in files if not key.startswith(("data/", ".stance/"))]
            assert sorted(others) == ["README.md", "croissant.json", "meta/manifest-1.json"], others
            manifest = json.loads(bench.request("GET", f"/{BUCKET}/{name}/meta/manifest-1.json"))
            named = [file["path"] for table in manifest["tables"].values() for file in table]
            assert sorted(named) == sorted(bench.data_files(name)), "files that nothing names"


@test
def without_a_cache_the_dataset_is_the_same(bench: Bench) -> None:
    bench.proxy.reset(FAULTS)
    out = f"s3://{BUCKET}/uncached"
    report = bench.json("ingest", bench.source, "--out", out, code=QUARANTINED, STANCE_REMOTE_CACHE_SIZE="0")
    assert report["root_hash"] == bench.local["root_hash"]
    bench.run("verify", out, STANCE_REMOTE_CACHE_SIZE="0")


@test
def pieces_made_by_several_processes_give_the_same_root_hash(bench: Bench) -> None:
    bench.clean_cache()
    bench.proxy.reset(FAULTS)
    out, plan = f"s3://{BUCKET}/pieces", WORK / "plan"
    bench.run("stage", "plan", "ingest", bench.source, "--into", out, "--out", plan)
    workers = [bench.start("stage", "work", plan, "--shard", f"{number}/2") for number in (0, 1)]
    ended = [(worker.communicate(), worker.returncode) for worker in workers]
    assert all(code == OK for _, code in ended), ended
    bench.run("stage", "commit", plan, code=QUARANTINED)
    assert bench.json("inspect", out)["root_hash"] == bench.local["root_hash"]
    assert not [key for key in bench.keys("pieces") if "staged" in key]


@test
def of_two_committers_at_once_one_wins_and_the_other_says_so(bench: Bench) -> None:
    for round_, seeds in enumerate([(1, 2), (3, 3)]):
        # Both runs have made everything before either may write its manifest.
        barrier = threading.Barrier(2)

        def before(request: Request) -> None:
            if request.method == "PUT" and "/meta/manifest-" in request.path:
                barrier.wait(timeout=120)

        bench.proxy.reset(Faults(before=before))
        out = f"s3://{BUCKET}/race{round_}"
        runs = [bench.start("ingest", bench.source, "--out", out, "--seed", seed, "--json") for seed in seeds]
        ended = [(run.communicate(), run.returncode) for run in runs]
        codes = sorted(code for _, code in ended)
        assert codes == [QUARANTINED, LOCKED], ended
        documents = {code: json.loads(texts[0]) for texts, code in ended}
        assert documents[LOCKED]["code"] == "E-OVERTAKEN", documents[LOCKED]
        assert out in documents[LOCKED]["reason"] and "run the command again" in documents[LOCKED]["reason"]
        bench.proxy.reset()
        assert bench.json("inspect", out)["root_hash"] == documents[QUARANTINED]["root_hash"]
        bench.run("verify", out, code=OK)
        # The run that lost runs again, on top of the version that won.
        lost = next(seed for seed, (_, code) in zip(seeds, ended) if code == LOCKED)
        again = bench.json("ingest", bench.source, "--out", out, "--seed", lost, code=QUARANTINED)
        assert again["already_complete"] or again["root_hash"]


@test
def real_files_give_the_root_hash_of_a_disk(bench: Bench) -> None:
    """Ingests a folder of this machine into the bucket: by the verb, and in pieces by four processes."""
    files = os.environ.get("STANCE_TEST_DATA")
    if not files:
        print("SKIPPED: STANCE_TEST_DATA names no folder")
        return
    local = bench.json("ingest", files, "--out", WORK / "real", code=QUARANTINED)
    bench.clean_cache()
    bench.proxy.reset(FAULTS)
    report = bench.json("ingest", files, "--out", f"s3://{BUCKET}/real", code=QUARANTINED)
    balanced(report)
    assert report["root_hash"] == local["root_hash"]
    out, plan = f"s3://{BUCKET}/real-pieces", WORK / "plan-real"
    bench.run("stage", "plan", "ingest", files, "--into", out, "--out", plan)
    workers = [bench.start("stage", "work", plan, "--shard", f"{number}/4") for number in range(4)]
    ended = [(worker.communicate(), worker.returncode) for worker in workers]
    assert all(code == OK for _, code in ended), ended
    committed = bench.json("stage", "commit", plan, code=QUARANTINED)
    assert committed["root_hash"] == local["root_hash"]
    print(f"   {local['root_hash']} three times")


@test
def a_killed_run_goes_on_to_the_same_dataset(bench: Bench) -> None:
    for number in range(3):
        out, seen = f"s3://{BUCKET}/killed{number}", threading.Event()

        def before(request: Request, number: int = number) -> None:
            parts = ["/data/motions/", "/data/quarantine/", "/meta/manifest-"]
            if request.method == "PUT" and parts[number] in request.path:
                seen.set()
                time.sleep(0.3)

        bench.proxy.reset(Faults(before=before))
        process = bench.start("ingest", bench.source, "--out", out)
        assert seen.wait(120), "a shard is written"
        process.send_signal(signal.SIGKILL)
        process.communicate()
        bench.proxy.wait_until_idle()
        bench.proxy.reset()
        again = bench.json("ingest", bench.source, "--out", out, code=QUARANTINED)
        assert again["root_hash"] == bench.local["root_hash"], number
        assert not [key for key in bench.keys(f"killed{number}") if "staged" in key or "tmp" in key]


@test
def a_source_that_cannot_be_read_is_quarantined_and_the_rest_goes_on(bench: Bench) -> None:
    victim = next(key for key in bench.keys("source") if key.endswith(".bvh") and "broken" not in key)
    bench.clean_cache()
    bench.proxy.reset(Faults(refused=lambda request: 403 if victim in request.path else 0))
    report = bench.json("ingest", bench.source, "--out", f"s3://{BUCKET}/refused", code=QUARANTINED)
    balanced(report)
    assert report["codes"]["E-IO"] == 1, report["codes"]
    assert report["ingested"] == bench.local["ingested"] - 1
    # Every response for this file is cut: the file is rejected, and no row is wrong.
    bench.clean_cache()
    bench.proxy.reset(Faults(cuts=lambda request: victim in request.path))
    report = bench.json("ingest", bench.source, "--out", f"s3://{BUCKET}/cut", code=QUARANTINED, STANCE_REMOTE_RETRIES="2")
    balanced(report)
    assert report["codes"].get("E-IO") == 1, report["codes"]


@test
def one_clip_costs_few_reads_and_a_second_time_none(bench: Bench) -> None:
    out = f"s3://{BUCKET}/plain"
    bench.clean_cache()
    rows = bench.json("inspect", WORK / "local", "--list", "clips")
    ids = [row["id"] for row in rows]
    for clip in (ids[0], ids[-1]):
        bench.clean_cache()
        bench.proxy.reset()
        shown = bench.json("inspect", out, "--clip", clip)
        assert shown == bench.json("inspect", WORK / "local", "--clip", clip)
        by_shard: dict[str, int] = {}
        for request in bench.proxy.reads("/data/motions/"):
            assert request.range, "shards are read by ranges"
            by_shard[request.path] = by_shard.get(request.path, 0) + 1
        # Three reads: the footer, the ids, and the clip.
        assert max(by_shard.values()) <= 3, by_shard
        bench.proxy.reset()
        assert bench.json("inspect", out, "--clip", clip) == shown
        assert not bench.proxy.reads("/data/motions/"), "the cache holds what was read"


@test
def damaged_and_cut_files_are_errors_that_name_the_url(bench: Bench) -> None:
    name = next(key for key in bench.data_files("plain") if "motions/train" in key)
    bytes_ = bench.request("GET", f"/{BUCKET}/plain/{name}")
    damaged = bytearray(bytes_)
    damaged[len(damaged) // 3] ^= 1
    bench.request("PUT", f"/{BUCKET}/plain/{name}", bytes(damaged))
    bench.clean_cache()
    bench.proxy.reset()
    text = bench.run("masks", f"s3://{BUCKET}/plain", code=FAILED).stderr
    assert f"s3://{BUCKET}/plain/{name}" in text and "BLAKE3" in text, text
    bench.run("verify", f"s3://{BUCKET}/plain", code=FAILED)
    bench.request("PUT", f"/{BUCKET}/plain/{name}", bytes_)
    bench.run("verify", f"s3://{BUCKET}/plain")
    # Every response is cut: this is an error, and never gives fewer rows.
    bench.clean_cache()
    bench.proxy.reset(Faults(cut=1))
    bench.run("stats", f"s3://{BUCKET}/plain", code=FAILED, STANCE_REMOTE_RETRIES="1")
    bench.proxy.reset(Faults(refused=lambda request: 403 if request.method == "GET" else 0))
    text = bench.run("inspect", f"s3://{BUCKET}/plain", code=FAILED).stderr
    assert f"s3://{BUCKET}/plain" in text, text


@test
def no_frames_are_cached_of_a_damaged_file(bench: Bench) -> None:
    bench.proxy.reset()
    url = bench.upload(WORK / "local", "composed")
    bench.run("masks", url)
    name = next(key for key in bench.data_files("composed") if "motions/train" in key)
    bytes_ = bench.request("GET", f"/{BUCKET}/composed/{name}")
    damaged = bytearray(bytes_)
    damaged[len(damaged) // 3] ^= 1
    bench.request("PUT", f"/{BUCKET}/composed/{name}", bytes(damaged))
    bench.clean_cache()
    triplets = ["triplets", url, "--count", 4, "--out", WORK / "composed"]
    text = bench.run(*triplets, code=FAILED).stderr
    assert f"{url}/{name}" in text and "BLAKE3" in text, text
    bench.request("PUT", f"/{BUCKET}/composed/{name}", bytes_)
    bench.run(*triplets)


@test
def the_stages_read_and_write_urls(bench: Bench) -> None:
    bench.proxy.reset()
    shutil.copytree(WORK / "local", WORK / "chain", dirs_exist_ok=True)
    url, local = bench.upload(WORK / "chain", "chain"), WORK / "chain"
    hashes: dict[str, list[str]] = {}
    tables, answers = [], []
    for place in (str(local), url):
        base = place.rsplit("/", 1)[0]
        bench.run("masks", place)
        bench.run("pairs", place)
        bench.run("triplets", place, "--count", 12, "--out", f"{base}/triplets")
        bench.run("items", place, "--count", 6, "--split", "train", "--out", f"{base}/items")
        run = WORK / ("run-local" if place == str(local) else "run-remote")
        config = WORK / "editor.toml"
        config.write_text("batch_size = 4\nval_every = 2\nlog_every = 1\n[model]\nwidth = 16\nnum_layers = 1\nnum_heads = 2\nfeed_forward = 16\n")
        bench.run("train", "motionrefit", place, "--out", run, "--config", config, "--steps", 2)
        bench.run("edit", run, "--items", f"{base}/items", "--name", "a", "--out", f"{base}/edits")
        bench.run("stats", place)
        asked = "SELECT action, has_mask, count(*) AS n, sum(seconds) AS s FROM motions GROUP BY action, has_mask ORDER BY action, has_mask"
        answers.append(bench.json("query", place, asked))
        bench.run("verify", place)
        for table in ("chain", "triplets", "items"):
            hashes.setdefault(table, []).append(bench.json("inspect", f"{base}/{table}")["root_hash"])
        bench.run("verify", f"{base}/edits")
        encoder = WORK / f"encoder-{run.name}"
        words = WORK / "encoder.toml"
        words.write_text("word_width = 16\n" + config.read_text())
        bench.run("train", "tmr", place, "--out", encoder, "--config", words, "--steps", 2)
        tables.append(bench.json("eval", f"{base}/edits", "--encoder", encoder, "--weak-judge"))
        bench.run("export", place, "--to", "bvh", "--out", WORK / f"bvh-{run.name}")
    for table, (one, other) in hashes.items():
        assert one == other, table
    ours, theirs = (
        {path.name: path.read_bytes() for path in (WORK / f"bvh-{name}").rglob("*.bvh")} for name in ("run-local", "run-remote")
    )
    assert ours and ours == theirs
    assert tables[0] and tables[0] == tables[1]
    assert answers[0] and answers[0] == answers[1]


@test
def what_cannot_be_remote_says_so(bench: Bench) -> None:
    url = f"s3://{BUCKET}/plain"
    for words, code in [
        (("train", "motionrefit", WORK / "local", "--out", f"s3://{BUCKET}/run"), USAGE),
        (("export", url, "--to", "bvh", "--out", f"s3://{BUCKET}/bvh"), USAGE),
        (("annotate", url), USAGE),
    ]:
        text = bench.run(*words, code=code).stderr
        assert "must be on this machine" in text, text
    assert not Path("s3:").exists()


@test
def a_dataset_in_the_cache_of_the_hub_is_read(bench: Bench) -> None:
    folder = WORK / "hub/hub/datasets--lab--clips"
    (folder / "refs").mkdir(parents=True)
    (folder / "refs/main").write_text("abc")
    shutil.copytree(WORK / "local", folder / "snapshots/abc")
    assert bench.json("inspect", "hf://datasets/lab/clips")["root_hash"] == bench.local["root_hash"]
    bench.run("verify", "hf://datasets/lab/clips")
    text = bench.run("inspect", "hf://datasets/lab/other", code=FAILED).stderr
    assert "hf download lab/other --repo-type dataset" in text, text


@test
def a_plain_web_server_is_read(bench: Bench) -> None:
    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *_: object) -> None:
            pass

    handler = functools.partial(Quiet, directory=str(WORK))
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    url = f"http://127.0.0.1:{server.server_port}"
    assert bench.json("inspect", f"{url}/local")["root_hash"] == bench.local["root_hash"]
    bench.run("verify", f"{url}/local")
    one = next((WORK / "source").rglob("*.bvh"))
    name = one.relative_to(WORK).as_posix()
    if "broken" not in name:
        report = bench.json("ingest", f"{url}/{name}", "--out", WORK / "one")
        assert report["ingested"] == 1
    bench.run("masks", f"{url}/local", code=FAILED)
    server.shutdown()


def main() -> None:
    started = time.monotonic()
    bench = Bench()
    bench.run("corpus", "--clips", 36, "--out", WORK / "source")
    (WORK / "source/broken.bvh").write_text("HIERARCHY\n")
    bench.local = bench.json("ingest", WORK / "source", "--out", WORK / "local", code=QUARANTINED)
    bench.source = bench.upload(WORK / "source", "source")
    passed = failed = 0
    chosen = sys.argv[3:]
    for function in TESTS:
        if chosen and not any(word in function.__name__ for word in chosen):
            continue
        begun = time.monotonic()
        try:
            function(bench)
            passed += 1
            print(f"ok {function.__name__} ({time.monotonic() - begun:.1f} s)", flush=True)
        except Exception as error:
            failed += 1
            traceback.print_exc()
            print(f"FAILED {function.__name__}: {error}", flush=True)
    print(f"{passed} passed, {failed} failed", flush=True)
    print(f"datasets at URLs: {time.monotonic() - started:.0f} s", flush=True)
    sys.exit(1 if failed else 0)


main()
