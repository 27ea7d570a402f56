"""Checks the package `stance` against the command: python check_package.py WORK (made by tests/python/package)."""

import base64
import functools
import html
import http.server
import json
import multiprocessing
import os
import pathlib
import pickle
import signal
import sys
import threading
import _thread

import numpy as np
import stance


def read_datasets(work: pathlib.Path) -> None:
    dataset = stance.Dataset(work / "dataset")
    assert len(dataset) == 120 == dataset.tables["motions"], dataset
    ids = dataset.ids()
    assert sorted(ids) == sorted(id for id, _ in dataset) and len(set(ids)) == 120
    assert sum(len(dataset.ids(split)) for split in ("train", "val", "test")) == 120

    frames = dict(zip(dataset.table("motions")["id"].to_pylist(), dataset.arrays("motions", "transl")))
    poses = dict(zip(dataset.table("motions")["id"].to_pylist(), dataset.arrays("motions", "body_pose")))
    for id, motion in dataset:
        assert np.array_equal(frames[id], motion.transl) and np.array_equal(poses[id], motion.body_pose)
    view = frames[ids[0]]
    assert not view.flags.owndata and not view.flags.writeable, "a view of Arrow's memory"

    motion = dataset[ids[0]]
    row = dataset.pandas("motions").set_index("id").loc[ids[0]]
    assert motion.content_hash == row.content_hash and len(motion) == row.n_frames
    assert dataset.polars("motions", columns=["id"])["id"].to_list() == dataset.table("motions")["id"].to_pylist()

    # Features are those that ingestion stored, to the last bit.
    stored = dict(zip(dataset.table("humanml3d")["id"].to_pylist(), dataset.arrays("humanml3d", "features")))
    assert np.array_equal(stored[ids[0]], motion.features("humanml3d"))


def motions_come_back(work: pathlib.Path) -> None:
    dataset = stance.Dataset(work / "dataset")
    motion = dataset[dataset.ids()[0]]
    joints = motion.joints()
    assert joints.shape == (len(motion), 22, 3) and motion.keypoints().shape == (len(motion), 28, 3)
    assert np.array_equal(motion.keypoints()[:, :22], joints)
    same = stance.Motion(motion.transl, motion.global_orient, motion.body_pose, motion.fps)
    assert same == motion == pickle.loads(pickle.dumps(motion))
    # The numbers may be of any type and layout.
    wide = stance.Motion(np.asfortranarray(motion.transl.astype(float)), motion.global_orient, motion.body_pose, motion.fps)
    assert wide == motion

    def distance(other: stance.Motion, frames: int = len(motion)) -> float:
        return float(np.abs(other.joints()[:frames] - joints[:frames]).max())

    # The tolerance of AMASS is the rounding of f32 positions of metres.
    assert distance(stance.Motion.from_amass(motion.to_amass())) < 1e-5
    again = stance.Motion.from_features(motion.features("motionfix"), "motionfix", first=motion.resample(30))
    assert np.abs(again.joints() - motion.resample(30).joints()).max() < 1e-3
    # These two drop position and heading of a motion, and its floor may be estimated again: compare heights relative to
    # the start, and the distance from head to foot.
    same_rate = motion.resample(30).joints()
    for recipe, width in (("272", 272), ("hy-motion", 201)):
        features = motion.features(recipe)
        assert features.shape == (len(same_rate), width)
        back = stance.Motion.from_features(features, recipe).joints()
        heights = [points[..., 1] - points[0, 0, 1] for points in (back, same_rate)]
        assert np.abs(heights[0] - heights[1]).max() < 1e-4, recipe
        spans = [np.linalg.norm(points[:, 15] - points[:, 10], axis=-1) for points in (back, same_rate)]
        assert np.abs(spans[0] - spans[1]).max() < 1e-4, recipe
    # A pose from joint positions alone is a fit to SMPL's bones, whose spine and collars point in other directions.
    fitted, error = stance.Motion.from_joints(joints, motion.fps)
    assert error < 0.01 and np.abs(fitted.joints() - joints).mean() < 0.03, error
    # HumanML3D's features have their own body and start, so compare the number of frames and the rate.
    posed = stance.Motion.from_features(motion.features("humanml3d"), "humanml3d")
    assert len(posed) == len(motion) - 1 and posed.fps == 20
    assert len(motion.crop(3, 9)) == 6 and motion.resample(10).fps == 10

    # A blend by parts takes only the target's arm; the collar is blended.
    other = next(clip for id, clip in dataset if id != dataset.ids()[0] and len(clip) >= len(motion))
    other = other.crop(0, len(motion))
    blended = stance.blend(motion, other, parts=["left arm"], alpha=0.25)
    arm = [16, 18, 20]
    for joint in range(1, 22):
        columns = slice(3 * (joint - 1), 3 * joint)
        taken = np.array_equal(blended.body_pose[:, columns], other.body_pose[:, columns])
        kept = np.array_equal(blended.body_pose[:, columns], motion.body_pose[:, columns])
        assert taken if joint in arm else kept or joint == 13, joint
    named = stance.blend(motion, other, hard=["left_shoulder", "left_elbow", "left_wrist"], soft=["left_collar"], alpha=0.25)
    assert named == blended


def motions_show_themselves(work: pathlib.Path) -> None:
    """The page in the iframe has positions rounded to a millimetre, and texts without markup."""
    dataset = stance.Dataset(work / "dataset")
    motion, other = (dataset[id] for id in dataset.ids()[:2])

    def data(page: str) -> dict:
        return json.loads(page.split('id="viewer-data">')[1].split("</script>")[0])

    def check(shown: dict, origin: np.ndarray, motion: stance.Motion) -> None:
        found = np.frombuffer(base64.b64decode(shown["points"]), "<i2").reshape(-1, 28, 3) / 1000
        # Tolerance: half a millimetre, and the rounding of f32 positions of metres.
        assert np.abs(found - (motion.keypoints() - origin)).max() < 0.5e-3 + 1e-6
        # 200 frames are 45 kB.
        assert len(shown["points"]) <= 224 * len(motion) + 4

    frame = motion._repr_html_()
    assert frame.startswith("<iframe srcdoc=") and frame.count("<") == 2, "the page is one attribute"
    page = html.unescape(frame.split('"')[1])
    (item,) = data(page)["items"]
    origin = motion.keypoints()[0, 0] * [1, 0, 1]
    assert item["fps"] == motion.fps
    check(item["motions"][0], origin, motion)

    hostile = "</script><img src=x>"
    # A motion at another rate is resampled to the rate of the first.
    shown = stance.show(motion, other.resample(10), names=["a", hostile], captions=["", "b"], title=hostile, joints=["left_elbow"])
    (item,) = data(shown.page)["items"]
    assert [part["label"] for part in item["motions"]] == ["a", f"{hostile}\nb"]
    assert [part["marked"] for part in item["motions"]] == [[18], [18]] and item["caption"] == hostile
    check(item["motions"][1], origin, other.resample(10).resample(motion.fps))
    assert "<img" not in shown.page and shown.page.count("<script") == 2
    shown.save(work / "shown.html")
    assert (work / "shown.html").read_text(encoding="utf-8") == shown.page

    triplet = stance.MotionCutMix(work / "dataset", seed=5).triplet(0, 3)
    page = html.unescape(triplet._repr_html_())
    assert data(page)["items"][0]["caption"] == triplet.instruction
    for wrong in ({"names": ["one"]}, {"captions": ["one", "two", "three"]}):
        try:
            stance.show(motion, other, **wrong)
        except ValueError as error:
            assert "2 motions" in str(error)
        else:
            raise AssertionError(wrong)


def windows_are_those_of_the_command(work: pathlib.Path) -> None:
    recorded = stance.Dataset(work / "windows")
    mix = stance.MotionCutMix(work / "dataset", seed=5, batch_size=7)
    table = recorded.table("windows")
    originals, edits = recorded.arrays("windows", "original"), recorded.arrays("windows", "edited")
    assert table.num_rows == 300
    batch = mix.windows(0, 300)
    assert batch.original.shape == (300, *mix.window_shape) == (300, 16, 84) and batch.original.dtype == np.float32
    for at in range(300):
        assert (int(table["epoch"][at].as_py()), int(table["item"][at].as_py())) == divmod(at, mix.epoch_len)
        assert np.array_equal(originals[at], batch.original[at]) and np.array_equal(edits[at], batch.edited[at]), at
        assert table["instruction"][at].as_py() == batch.instructions[at]
    assert np.array_equal(batch.progress, table["progress"].to_numpy())
    assert set(batch.instructions) <= set(mix.instructions)

    # Batches are pieces of the same stream, also across the end of an epoch.
    many = iter(mix)
    for k in range(300 // 7):
        assert np.array_equal(next(many).edited, batch.edited[7 * k : 7 * k + 7]), k
    across = mix.windows(mix.epoch_len - 3, 6)
    assert np.array_equal(across.edited[3:], mix.windows(mix.epoch_len, 3).edited)

    # A state continues where it was saved; a state of another stream is refused.
    state = mix.state_dict()
    again = stance.MotionCutMix(work / "dataset", seed=5, batch_size=7)
    again.load_state_dict(state)
    assert np.array_equal(next(iter(again)).edited, next(many).edited)
    try:
        stance.MotionCutMix(work / "dataset", seed=6, batch_size=7).load_state_dict(state)
    except ValueError as error:
        assert "seed" in str(error)
    else:
        raise AssertionError("a state of another seed was taken")

    # Two ranks share the batches of one stream.
    halves = [stance.MotionCutMix(work / "dataset", seed=5, batch_size=7, rank=r, world_size=2) for r in (0, 1)]
    dealt = [next(stream) for _ in range(3) for stream in map(iter, halves)][:2]
    assert np.array_equal(dealt[1].edited, batch.edited[7:14])

    # The last batch of an epoch holds the remaining windows.
    once = stance.MotionCutMix(work / "dataset", seed=5, batch_size=50, epochs=1)
    sizes = [len(part.progress) for part in once]
    assert sum(sizes) == once.epoch_len and len(sizes) == once.num_batches and set(sizes[:-1]) <= {50}

    # Keypoints in metres, and whole clips.
    metres = mix.to_metres(batch.edited[:4])
    assert metres.shape == (4, 16, 28, 3) and np.abs(metres).max() < 5
    triplet = mix.triplet(0, 3)
    rows = stance.Dataset(work / "triplets").table("triplets").to_pylist()
    row = next(row for row in rows if row["id"] == triplet.id)
    assert row["instruction"] == triplet.instruction and np.array_equal(np.asarray(row["edited_body_pose"], np.float32), triplet.edited.body_pose)

    # Validation windows in the units of training.
    val = stance.MotionCutMix(work / "dataset", split="val", normalizer=mix.normalizer)
    assert val.normalizer == mix.normalizer and val.windows(0, 2).edited.shape == (2, 16, 84)
    only = stance.MotionCutMix(work / "dataset", {"kinds": ["style"]})
    assert 0 < only.epoch_len < mix.epoch_len and only.config["kinds"] == ["style"]


def first_edited(mix: stance.MotionCutMix) -> np.ndarray:
    return mix.windows(0, 64).edited


def processes_share_a_stream(work: pathlib.Path) -> None:
    mix = stance.MotionCutMix(work / "dataset", seed=5)
    here = first_edited(mix)
    for start in ("fork", "spawn"):
        with multiprocessing.get_context(start).Pool(2) as pool:
            for there in pool.map(first_edited, [mix] * 4):
                assert np.array_equal(here, there), start


def scores_are_those_of_the_command(work: pathlib.Path) -> None:
    expected = json.loads((work / "scores.json").read_text())
    by_name = {(row["system"], row["task"], row["metric"]): row["mean"] for row in expected}
    items = stance.Dataset(work / "items").items()
    assert len(items) == 32 and all(item.target is not None for item in items)
    folders = stance.evaluate([work / "edits"], work / "items", work / "encoder")
    for row in folders.rows:
        assert by_name[row["system"], row["task"], row["metric"]] == row["mean"], row
    assert len(folders.rows) == len(expected)

    nearest = stance.Dataset(work / "edits")
    assert nearest.tables["edits"] == 32
    # Returning each source equals the identity editor, to the last digit.
    own = stance.evaluate({"Mine": {item.id: item.source for item in items}}, work / "items", work / "encoder")
    frame = own.pandas()
    for metric in ("E2T R@1", "E2T AvgR", "FS"):
        assert own.value("Mine", metric) == own.value("Identity", metric) == frame.loc[("all", "Mine"), metric], metric
    assert own.polars().shape[0] == len(frame) and "Mine" in str(own)
    try:
        stance.evaluate({"Mine": {items[0].id: items[0].source}}, work / "items", work / "encoder")
    except stance.Error as error:
        assert "Mine" in str(error)
    else:
        raise AssertionError("a system without all answers was scored")

    encoder = stance.Encoder(work / "encoder")
    latents = encoder.encode([item.target for item in items])
    assert latents.shape[0] == 32 and encoder.encode_texts(["wave"]).shape == (1, latents.shape[1])
    assert stance.retrieval(latents, latents, gallery_size=None)["R@1"] > 90


def metrics_have_their_closed_forms() -> None:
    rng = np.random.default_rng(0)
    latents = rng.normal(size=(400, 4))
    assert abs(stance.fid(latents, latents)) < 1e-9
    # A shift changes only the mean: the FID is its squared length.
    assert abs(stance.fid(latents, latents + [1, 0, 0, 0]) - 1) < 1e-6
    assert stance.diversity(np.ones((10, 3))) == 0 and stance.diversity(latents) == stance.diversity(latents)
    assert stance.multimodality(np.ones((5, 20, 3))) == 0
    still = np.zeros((10, 28, 3))
    assert stance.foot_score(still, 20) == 1 and stance.jerk(still, 20) == 0 and stance.foot_slide(still, 20) == 0
    # All points move sideways by 0.1 m a frame at 20 fps.
    moving = still + np.arange(10)[:, None, None] * [0.1, 0, 0]
    assert abs(stance.foot_slide(moving, 20) - 2) < 1e-9
    assert abs(stance.position_error(still, still + [0, 3, 4]) - 5) < 1e-12


def errors_have_codes(work: pathlib.Path) -> None:
    def code(call, *arguments, **keywords) -> str:
        try:
            call(*arguments, **keywords)
        except stance.Error as error:
            assert str(error) and pickle.loads(pickle.dumps(error)).args == error.args
            return error.code
        raise AssertionError("no error")

    dataset = stance.Dataset(work / "dataset")
    assert code(stance.Dataset, work) == "E-DATASET"
    assert code(dataset.motion, "nobody") == "E-CLIP-UNKNOWN"
    assert code(stance.ingest, work / "nowhere", work / "x") == "E-MISSING"
    bad = work / "bad.bvh"
    bad.write_text("HIERARCHY\nROOT hips\n{\n")
    assert code(stance.Motion.read, bad).startswith("E-BVH")
    assert code(stance.MotionCutMix, dataset, {"mcm_ratio": 2}) == "E-FAILED"
    assert code(stance.MotionCutMix, dataset, {"ratio": 1}) == "E-FAILED"
    assert code(stance.Motion, np.zeros((4, 3)), np.zeros((4, 3)), np.zeros((4, 60)), 20) == "E-FAILED"
    assert code(stance.show) == code(stance.show, dataset[dataset.ids()[0]], joints=["tail"]) == "E-FAILED"


def ingestion_is_that_of_the_command(work: pathlib.Path) -> None:
    command = stance.Dataset(work / "dataset")
    counts = stance.ingest(work / "corpus", work / "again", features="humanml3d")
    assert counts["sources"] == counts["ingested"] + counts["quarantined"] + counts["skipped"]
    assert counts["ingested"] == 120
    assert stance.Dataset(work / "again").arrays("motions", "transl")[0].shape[1] == 3
    stance.masks(work / "again")
    again = stance.Dataset(work / "again")
    for table in ("motions", "masks"):
        hashes = [[file["blake3"] for file in dataset.manifest["tables"][table]] for dataset in (command, again)]
        assert hashes[0] == hashes[1], table


def a_dataset_is_read_from_an_address(work: pathlib.Path) -> None:
    """Files of a dataset on an HTTP server are copied once, when they are needed."""
    asked: list[str] = []

    class Handler(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *_: object) -> None:
            asked.append(self.path)

    os.environ["STANCE_CACHE"] = str(work / "cache")
    handler = functools.partial(Handler, directory=str(work))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        url = f"http://127.0.0.1:{server.server_port}/dataset"
        local, remote = stance.Dataset(work / "dataset"), stance.Dataset(url)
        assert remote.root_hash == local.root_hash and len(remote) == len(local)
        assert not any(path.endswith(".parquet") for path in asked), "opening reads the manifest alone"
        assert remote.ids() == local.ids() and remote[remote.ids()[5]] == local[local.ids()[5]]
        copied = [path for path in asked if path.endswith(".parquet")]
        assert copied and all("/motions/" in path for path in copied), copied
        mix = stance.MotionCutMix(url, seed=5)
        assert np.array_equal(mix.windows(0, 4).edited, stance.MotionCutMix(local, seed=5).windows(0, 4).edited)
        once = [path for path in asked if path.endswith(".parquet")]
        assert len(once) == len(set(once)), "each file is copied once"
        try:
            stance.Dataset(f"http://127.0.0.1:{server.server_port}/corpus")
        except stance.Error as error:
            assert error.code == "E-DATASET"
        else:
            raise AssertionError("a folder without a manifest was opened")
        source = next(path for path in sorted((work / "corpus").rglob("*.bvh")))
        counts = stance.ingest(f"http://127.0.0.1:{server.server_port}/{source.relative_to(work).as_posix()}", work / "from-url")
        assert counts["ingested"] == 1 and len(stance.Dataset(work / "from-url")) == 1
        server.shutdown()


def an_interrupt_ends_long_work(work: pathlib.Path) -> None:
    """Interrupts an ingestion once it holds its folder; the second run goes on and gives the same dataset."""
    # A shell may start background processes with interrupts ignored. Python inherits this, so set its own handler.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    stance.corpus(work / "many", clips=1200)
    # On a busy machine the ingestion may be done before the other thread runs; then the next one is interrupted.
    out = next(out for number in range(10) if is_interrupted(work / "many", out := work / f"interrupted{number}"))
    assert stance.ingest(work / "many", out)["ingested"] == 1200
    assert stance.Dataset(out).root_hash == stance.ingest(work / "many", work / "whole")["root_hash"]


def is_interrupted(source: pathlib.Path, out: pathlib.Path) -> bool:
    ended = threading.Event()

    def interrupt() -> None:
        # This loop runs while the main thread ingests, because the ingestion releases Python's global lock.
        while not out.exists():
            pass
        if not ended.is_set():
            _thread.interrupt_main()

    thread = threading.Thread(target=interrupt, daemon=True)
    try:
        thread.start()
        stance.ingest(source, out, progress=False)
        ended.set()
        # An interrupt that came as the ingestion ended must be raised here, not later.
        thread.join()
    except KeyboardInterrupt:
        return not (out / "meta" / "manifest-1.json").exists()
    return False


if __name__ == "__main__":
    work = pathlib.Path(sys.argv[1])
    read_datasets(work)
    motions_come_back(work)
    motions_show_themselves(work)
    windows_are_those_of_the_command(work)
    processes_share_a_stream(work)
    scores_are_those_of_the_command(work)
    metrics_have_their_closed_forms()
    errors_have_codes(work)
    ingestion_is_that_of_the_command(work)
    a_dataset_is_read_from_an_address(work)
    an_interrupt_ends_long_work(work)
    print("the Python package agrees with the command")
